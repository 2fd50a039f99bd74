"""``python -m elastoidentify`` is ``elastoidentify``."""

import sys

from .cli import main

sys.exit(main())
