"""One method on one case, in a process of its own: `python child.py METHOD CASE ANSWER`.

So that each has its own memory, its own time and, if it asks for one, its own environment.
"""

import importlib
import pickle
import resource
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))


def forward_solve(case) -> float:
    """Return the processor seconds of one forward solution: stiffness, SuperLU, every trial."""
    import scipy.sparse.linalg as spl
    from elastoidentify.fem.assembly import tangent_stiffness
    from elastoidentify.fem.constitutive import KINEMATICS
    from elastoidentify.fem.mesh import make_mesh

    start = time.process_time()
    mesh = make_mesh(case.points, [(case.kind, case.cells)])
    ones, law = np.ones(mesh.n_cells), KINEMATICS["small-strain"]
    K = tangent_stiffness(mesh, law, 0 * case.points, ones, ones)
    free = np.flatnonzero(~np.repeat(case.reaction, case.points.shape[1]))
    factors = spl.splu(K[free][:, free].tocsc())
    factors.solve(np.ones((len(free), len(case.displacements))))
    return time.process_time() - start


def peak(reset: bool = False) -> float:
    """Return this process's largest resident memory, MiB; with `reset`, from now on."""
    try:
        if reset:
            Path("/proc/self/clear_refs").write_text("5")
        status = Path("/proc/self/status").read_text()
        return next(int(one.split()[1]) for one in status.splitlines() if "VmHWM" in one) / 1024
    except OSError:  # not Linux
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main(method, case, answer):
    with open(case, "rb") as file:
        case = pickle.load(file)
    module = importlib.import_module(f"open_benchmark.methods.{method}")
    skip = importlib.import_module("open_benchmark.problem").Skip
    found = {"forward_seconds": min(forward_solve(case) for _ in range(2))}
    before = peak(reset=True)
    start = time.process_time()
    try:
        found["estimate"] = module.estimate(case)
    except skip as reason:
        found["skipped"] = str(reason)
    except Exception as failed:  # a failure is an entry of the table, whatever it was
        found["failed"] = f"{type(failed).__name__}: {failed}"
    found["seconds"] = time.process_time() - start
    # of its own: what loading this product, scipy and the case took is taken off
    found["memory_mib"] = peak() - before
    found["versions"] = {one: _version(one) for one in ("numpy", "scipy")}
    with open(answer, "wb") as file:
        pickle.dump(found, file)


def _version(name):
    return getattr(sys.modules.get(name), "__version__", None)


if __name__ == "__main__":
    main(*sys.argv[1:])
