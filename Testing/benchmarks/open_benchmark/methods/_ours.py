"""What this product's methods share: defaults, and ν where the problem gives it."""

import elastoidentify as ei

from ..problem import Case, Estimate


def identify(case: Case, method: str, **options) -> Estimate:
    nu = {} if case.poisson is None else {"unknowns": "young", "poisson_ratio": case.poisson}
    result = ei.identify(
        case.points, [(case.kind, case.cells)], case.displacements, case.known,
        reaction_nodes=case.reaction, method=method, plane=case.plane, kinematics=case.kinematics,
        information=case.information, **nu, **options,
    )  # fmt: skip
    remarks = {
        "elastoidentify": ei.__version__,
        "verdict": result.report["verdict"]["level"],
        "factorisation": result.report.get("factorisation"),
    }
    return Estimate(result.young, result.young_std, result.poisson, remarks)
