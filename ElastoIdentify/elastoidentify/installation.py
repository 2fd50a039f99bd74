"""How to install what is missing: from the folder of the clone, since no index has the package."""


def needs(what: str, extra: str) -> str:
    """Return "needs WHAT, install it with …" for a package of one of our extras."""
    return f'needs {what}, install it from the folder of the clone with: pip install ".[{extra}]"'
