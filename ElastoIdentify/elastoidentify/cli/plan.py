"""The command that plans a study before anybody is imaged."""

import argparse

from ..report.terminal import TerminalProgress, figure, table
from ..study import IdentificationOptions, MeshOptions, ReadOptions, Study
from . import commands
from . import parser as options


def plan(arguments) -> None:
    """Say how small a lesion would be seen, by pushes and edge length, before imaging."""
    from ..planning import plan as planned
    from ..planning import plan_rows

    study = commands._read(arguments, Study).chosen
    if not hasattr(arguments, "method"):
        study.method = "regularized"
    with TerminalProgress("plan") as progress:
        rows = planned(
            study, arguments.pushes, tissue=arguments.tissue, place=arguments.at,
            edge_lengths=arguments.edge_lengths or (), progress=progress,
        )  # fmt: skip
    lines = plan_rows(rows)
    print(table(list(lines[0]), [[_cell(value) for value in row.values()] for row in lines]))
    print(
        "A lesion of twice the stiffness shows with about half of its contrast at this diameter, "
        "and with most of it at one and a half times as much."
    )
    if arguments.table:
        from ..report.table import write_table

        write_table(arguments.table, lines)
        print(f"wrote {arguments.table}")


def declare(parser) -> None:
    """Declare the options of the command."""
    options.add_options(parser, MeshOptions, ["edge_length", "slice_axis", "slice_index"])
    add = parser.add_argument
    add(
        "--edge-length",
        dest="edge_lengths",
        action="append",
        type=options._checked(MeshOptions.edge_length),
        metavar="LENGTH",
        help="of the cells; repeatable, to compare",
    )
    add(
        "--push",
        dest="pushes",
        action="append",
        required=True,
        type=_push,
        metavar="LABEL:X,Y,Z",
        help="rigid label that pushes, and its motion in the world; one per trial",
    )
    add(
        "--tissue",
        type=_tissue,
        metavar="E=MODULUS,nu=RATIO",
        help="what the tissue is expected to be (default: as the known material)",
    )
    add(
        "--at",
        type=options.parse_numbers(3),
        metavar="X,Y,Z",
        help="where a lesion is expected, in the world (default: the middle)",
    )
    options.add_options(parser, IdentificationOptions, ["reference_label"])
    options.add_options(parser, ReadOptions)
    add("--table", metavar="OUT.csv", help="write the figures")


def _push(text: str) -> tuple[int, tuple[float, ...]]:
    label, _, motion = text.partition(":")
    if not label.strip().isdigit():
        raise argparse.ArgumentTypeError(f"{text!r} is not LABEL:X,Y,Z, as in 4:0,2,0")
    return int(label), options.parse_numbers(3)(motion)


def _tissue(text: str) -> tuple[float, float]:
    try:
        return options.parse_known(f"1:{text}")[1:]
    except argparse.ArgumentTypeError:
        raise argparse.ArgumentTypeError(f"{text!r} is not E=MODULUS,nu=RATIO") from None


def _cell(value) -> str:
    if isinstance(value, float):
        return "none" if value == float("inf") else figure(value)
    return str(value)
