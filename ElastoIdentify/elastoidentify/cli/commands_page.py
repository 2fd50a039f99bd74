"""The page of commands in the docs, made from the parsers.

``python -m elastoidentify.cli.commands_page > docs/commands.md``
"""

import argparse

from .parser import make_parser

INTRODUCTION = """# All commands

Made from the commands themselves; `elastoidentify COMMAND --help` says the same. What they are for,
file by file and step by step, is in [the command line](command-line.md); values, defaults and the
names of options in other hosts are in [all options](options.md).
"""
NOT_PARSED = "Its arguments are those of ParaView; see [ParaView](paraview.md)."


def commands_page() -> str:
    """Return the page in Markdown."""
    subparsers = next(
        action
        for action in make_parser()._actions
        if isinstance(action, argparse._SubParsersAction)
    )
    helps = {choice.dest: choice.help for choice in subparsers._choices_actions}
    parts = [INTRODUCTION]
    parts += [_section(name, helps[name], one) for name, one in subparsers.choices.items()]
    return "\n".join(parts)


def _section(name: str, text: str, parser) -> str:
    lines = [f"## {name}\n", text, ""]
    actions = [action for action in parser._actions if action.dest != "help"]
    if name == "paraview":
        return "\n".join([*lines, NOT_PARSED, ""])
    if not actions:
        return "\n".join([*lines, f"`elastoidentify {name}` has no options.", ""])
    lines += ["| argument | meaning |", "|---|---|"]
    required = [action for action in actions if action.required]
    lines += [_line(action) for action in required]
    lines += [_line(action) for action in actions if not action.required]
    return "\n".join([*lines, ""])


def _line(action) -> str:
    value = "" if action.nargs == 0 else _value(action)
    words = " ".join(f"`{flag}`" for flag in action.option_strings)
    shown = f"{words} {value}".strip() if words else value
    text = (action.help or "").replace("%%", "%").replace("|", "\\|")
    needed = "**needed.** " if action.required else ""
    return f"| {shown} | {needed}{text[:1].upper()}{text[1:]} |"


def _value(action) -> str:
    if action.choices:
        return " or ".join(f"`{choice}`" for choice in action.choices)
    return f"`{action.metavar or action.dest.upper()}`"


if __name__ == "__main__":
    print(commands_page(), end="")
