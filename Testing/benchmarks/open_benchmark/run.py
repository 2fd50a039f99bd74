"""The open benchmark: every method on every problem, scored alike, into one JSON file.

    python Testing/benchmarks/open_benchmark/run.py                    # all of it
    python Testing/benchmarks/open_benchmark/run.py --problem two_discs --method regularized
    python Testing/benchmarks/open_benchmark/run.py --quick            # under a minute
    python Testing/benchmarks/open_benchmark/run.py --page             # docs/open-benchmark.md anew

Results are added to the JSON file, an entry replaced by its successor. Set OMP_NUM_THREADS to use
more than one core per method. docs/open-benchmark.md says how to contest an entry or add a method.
"""

import argparse
import json
import os
import pickle
import platform
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
TESTING = HERE.parents[1]
sys.path[:0] = [str(TESTING / "benchmarks"), str(TESTING)]

from open_benchmark import methods, problems, scores  # noqa: E402
from open_benchmark.problem import Skip  # noqa: E402

RESULTS = HERE / "results.json"
LIMIT = 1_200  # processor seconds


def machine() -> dict:
    """Return the class of the hardware, not its name."""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    model = ""
    if os.path.exists("/proc/cpuinfo"):
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            model = next((one for one in file if one.startswith("model name")), ":")
    return {
        "cores": os.cpu_count(),
        "memory_gib": round(memory),
        "processor": model.split(":")[-1].strip() or platform.machine(),
        "system": platform.system(),
        "python": platform.python_version(),
        "threads": int(os.environ["OMP_NUM_THREADS"]),
    }


def interpreter(method) -> str:
    """Return the Python that runs a method; raise Skip where it wants one that is not named."""
    variable = getattr(method, "PYTHON", None)
    if variable is None:
        return sys.executable
    if variable not in os.environ:
        raise Skip(f"set {variable} to the Python of an environment that has it")
    return os.environ[variable]


def run_method(name: str, case_file: Path, limit: float) -> dict:
    """Run a method in a process of its own and return what it left."""
    import elastoidentify

    answer = case_file.with_name(f"{name}.pkl")
    library = str(Path(elastoidentify.__file__).parents[1])
    python = interpreter(methods.load(name))
    command = [python, str(HERE / "child.py"), name, str(case_file), str(answer)]
    limited = ["bash", "-c", f'ulimit -t {limit:.0f}; exec "$@"', "child", *command]
    environment = os.environ | {"PYTHONPATH": library}
    ended = subprocess.run(limited, env=environment, capture_output=True, text=True)
    if not answer.exists():
        last = (ended.stderr.strip().splitlines() or ["no word"])[-1]
        stopped = ended.returncode in (-9, -24, 137, 152)
        return {"failed": f"stopped after {limit:.0f} processor seconds" if stopped else last}
    with open(answer, "rb") as file:
        return pickle.load(file)


def entry(name: str, case, truth, case_file: Path, limit: float) -> dict:
    """Return one entry of the results: scores and cost, or why there are none."""
    try:
        found = run_method(name, case_file, limit)
    except Skip as reason:
        return {"skipped": str(reason)}
    if "estimate" not in found:
        return {key: found[key] for key in ("skipped", "failed") if key in found}
    return {
        **scores.score(case, truth, found["estimate"]),
        "forward_solves": found["seconds"] / found["forward_seconds"],
        "seconds": found["seconds"],
        "memory_mib": found["memory_mib"],
        "remarks": found["estimate"].remarks | found["versions"],
    }


def run_problem(name: str, levels, chosen, limit: float):
    """Yield (level, method, entry) of a problem."""
    problem = problems.load(name)
    for level in levels:
        try:
            case, truth = problem.make(level)
        except Skip as reason:
            yield from ((level, method, {"skipped": str(reason)}) for method in chosen)
            continue
        with tempfile.TemporaryDirectory() as folder:
            case_file = Path(folder) / "case.pkl"
            case_file.write_bytes(pickle.dumps(case))
            for method in chosen:
                found = entry(method, case, truth, case_file, limit)
                yield level, method, found | {"cells": len(case.cells)}


def main(arguments=None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--problem", nargs="+", choices=problems.NAMES, default=problems.NAMES)
    parser.add_argument("--level", nargs="+", help="noise levels by name; default: all")
    parser.add_argument("--method", nargs="+", choices=methods.NAMES, default=methods.NAMES)
    parser.add_argument("--quick", action="store_true", help="small problems, one level each")
    parser.add_argument("--limit", type=float, default=LIMIT, help="processor seconds per method")
    parser.add_argument("--out", type=Path, default=RESULTS, help="JSON file")
    parser.add_argument("--page", action="store_true", help="only write the page from the JSON")
    chosen = parser.parse_args(arguments)
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", os.environ["OMP_NUM_THREADS"])
    results = json.loads(chosen.out.read_text()) if chosen.out.exists() else {}
    for name in () if chosen.page else chosen.problem:
        problem = problems.load(name)
        levels = [one for one in problem.LEVELS if not chosen.level or one in chosen.level]
        if chosen.quick:
            levels = [problem.QUICK] if problem.QUICK else []
        for level, method, found in run_problem(name, levels, chosen.method, chosen.limit):
            place = results.setdefault(name, {}).setdefault(level, {})
            place[method] = found | {"machine": machine()}
            print(f"{name}, {level}, {method}: {_line(found)}", flush=True)
            chosen.out.write_text(json.dumps(results, indent=1, ensure_ascii=False) + "\n")
    if chosen.page:
        from open_benchmark import page

        page.write(results)


def _line(found):
    if "rms" not in found:
        return (
            f"skipped: {found['skipped']}" if "skipped" in found else f"failed: {found['failed']}"
        )
    return (
        f"RMS {found['rms']:.3f}, median error {found['median_error']:.1%}, "
        f"{found['forward_solves']:.0f} forward solves, {found['memory_mib']:.0f} MiB"
    )


if __name__ == "__main__":
    main()
