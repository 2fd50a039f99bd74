"""How to install what is missing: from the folder of the clone, since no index has the package."""


def hint(extra: str) -> str:
    """Return the words "install it from …" for one of the extras of pyproject.toml."""
    return f'install it from the folder of the clone with: pip install ".[{extra}]"'


def needs(what: str, extra: str) -> str:
    """Return the words "needs WHAT, install it from …"."""
    return f"needs {what}, {hint(extra)}"
