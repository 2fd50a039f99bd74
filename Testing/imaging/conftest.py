"""What the tests of images share."""

import pytest


@pytest.fixture(scope="module")
def waiting_elastix():
    """An elastix that stays for the next registration, for the tests of one file."""
    from quick_elastix import waiting_elastix

    with waiting_elastix():
        yield
