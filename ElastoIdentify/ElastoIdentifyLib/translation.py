"""What the library says, in the user's language.

Its sentences come with numbers and names filled in, so the template of each is looked for,
translated and filled again. Of what is put together from several, each is translated.
"""

import re
from contextlib import contextmanager
from functools import cache

from elastoidentify.errors import InputError

from .messages import TEMPLATES, in_users_language


def translated(text: str) -> str:
    """Return what the library says in the user's language; what is not known stays as it is."""
    for match in (re.Pattern.fullmatch, re.Pattern.search):
        for template, texts, pattern in _patterns():
            found = all(one in text for one in texts) and match(pattern, text)
            if found:
                own = in_users_language(template).format(*map(translated, found.groups()))
                before, after = text[: found.start()], text[found.end() :]
                return translated(before) + own + translated(after)
    return text


@cache
def _patterns() -> list[tuple[str, list[str], re.Pattern]]:
    """Return (template, its texts between what is filled in, what it matches), longest first."""
    made = []
    for template in TEMPLATES:
        texts = [text.format() for text in re.split(r"\{\d+\}", template)]  # {{ is a brace
        pattern = re.compile("(.*?)".join(map(re.escape, texts)), re.S)
        made.append((template, texts, pattern))
    return sorted(made, key=lambda one: -sum(map(len, one[1])))


@contextmanager
def refused_in_users_language():
    """Raise what the library refuses in the user's language."""
    try:
        yield
    except InputError as problem:
        raise InputError(translated(str(problem))) from problem
