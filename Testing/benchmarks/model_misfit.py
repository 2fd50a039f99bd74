"""Where the model does not fit: what ModelMisfit flags of bodies that break one assumption each.

    python Testing/benchmarks/model_misfit.py                    # forward data, white noise
    python Testing/benchmarks/model_misfit.py --volumes          # the same in space
    python Testing/benchmarks/model_misfit.py --phantoms 5 8 10  # images, ν given wrongly

First form: bodies of Testing/broken.py, quadratic cells on a finer mesh. "found": flagged share of
the cells in which the model error lives; "false": of the cells that are neither those nor more than
25 % wrong in E. Second form: bodies of Testing/broken_volumes.py, likewise. Third form: phantoms of
images_to_moduli.py, 3:1, the inclusion hidden; the share of the tissue and of the pad that is
flagged, of the tissue that is more than 25 % wrong in E, the noise found over that stated, and the
verdict.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from elastoidentify import identify
from elastoidentify.inverse.model_misfit import FLAGGED
from elastoidentify.workers.elastix_client import ElastixProcess

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

NOISE, VOLUME_NOISE = 0.01, 5e-4  # mm; of the height, 1 % of the push
WRONG = np.log(1.25)
KINDS = {
    "sound": {},
    "slip": {"kind": "slip"},
    "ν 0.49 for 0.45": {"kind": "poisson", "true_poisson": 0.49},
    "ν 0.47 for 0.45": {"kind": "poisson", "true_poisson": 0.47},
    "ν 0.40 for 0.45": {"kind": "poisson", "true_poisson": 0.40},
    "fibres": {"kind": "fibres"},
    "out of the plane": {"kind": "stretch"},
}


def exact(seed: int) -> None:
    """Print a line per broken assumption."""
    import broken

    print("| what is wrong | found | false | noise | verdict |\n|---|---|---|---|---|")
    for name, choice in KINDS.items():
        body = broken.body(**choice)
        u = body.noisy(NOISE, seed)
        result = identify(
            body.points, body.cells, u, {1: (1.0, body.poisson)}, labels=body.labels,
            reaction_nodes=body.reaction, unknowns="young", poisson_ratio=body.poisson,
            method="regularized", information=np.broadcast_to(np.eye(2) / NOISE**2, (*u.shape, 2)),
        )  # fmt: skip
        flagged = result.model_misfit > FLAGGED
        right = body.known | (np.abs(np.log(result.young / body.young)) < WRONG)
        hit, false = (_share(flagged, c) for c in (body.offending, ~body.offending & right))
        print(f"| {name} | {hit} | {false} | {_end(result)}", flush=True)


def volumes(seed: int) -> None:
    """Print a line per body in space."""
    from broken_volumes import PAD, block, pushed_cube

    bodies = {
        "the pad slips": lambda: block(told_to_slip=False),
        "it slips, and that is told": lambda: block(told_to_slip=True),
        "nothing, ν 0.45": lambda: pushed_cube(0.45, 0.45, n=8, fine=16),
        "ν 0.49 for 0.45": lambda: pushed_cube(0.49, 0.45, n=8, fine=16),
        "ν 0.40 for 0.45": lambda: pushed_cube(0.40, 0.45, n=8, fine=16),
    }
    print("| what is wrong | cells | found | false | noise | verdict |\n|---|---|---|---|---|---|")
    for name, make in bodies.items():
        body = make()
        u, std = body.noisy(VOLUME_NOISE, seed)
        result = identify(
            body.points, body.cells, u, {PAD: body.pad}, labels=body.labels, slip=body.slip,
            reaction_nodes=body.reaction, unknowns="young", poisson_ratio=body.poisson,
            method="regularized", information=np.broadcast_to(np.eye(3) / std**2, (*u.shape, 3)),
        )  # fmt: skip
        flagged = result.model_misfit > FLAGGED
        right = (body.labels == PAD) | (np.abs(np.log(result.young / body.young)) < WRONG)
        hit, false = (_share(flagged, c) for c in (body.offending, ~body.offending & right))
        print(f"| {name} | {len(flagged)} | {hit} | {false} | {_end(result)}", flush=True)


def registered(numbers) -> None:
    """Print lines per phantom: ν as it is, and off by 0.03."""
    from images_to_moduli import INCLUSION, PAD, TISSUE, make_case

    print("| phantom | ν given | tissue | pad | E wrong | noise | verdict |")
    print("|---|---|---|---|---|---|---|")
    with ElastixProcess() as elastix:
        for number in numbers:
            case = make_case(3, number, elastix=elastix)
            tissue, true = case.labels != PAD, case.phantom.materials[PAD].poisson
            young = case.true_young
            case.labels[case.labels == INCLUSION] = TISSUE
            for given in (true, true + 0.03, true - 0.03):
                result = case.identify("informed", "cell", poisson_ratio=given)
                flagged = result.model_misfit > FLAGGED
                wrong = ~(np.abs(np.log(result.young / young)) < WRONG)
                print(
                    f"| {number} | {given:.2f} | {_share(flagged, tissue)} "
                    f"| {_share(flagged, ~tissue)} | {_share(wrong, tissue)} | {_end(result)}",
                    flush=True,
                )


def _share(flagged, cells) -> str:
    return f"{flagged[cells].mean():.1%}" if cells.any() else "–"


def _end(result) -> str:
    verdict = result.report["verdict"]
    return f"{verdict['noise_factor']:.2f} | {verdict['level']} |"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--phantoms", nargs="+", type=int)
    parser.add_argument("--volumes", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    if arguments.phantoms:
        registered(arguments.phantoms)
    elif arguments.volumes:
        volumes(arguments.seed)
    else:
        exact(arguments.seed)


if __name__ == "__main__":
    main()
