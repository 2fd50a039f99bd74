"""What nodes that a registration lost do to a map: found and not believed, and believed.

The square of ``forward.py`` (quadratic cells of a finer mesh; identification on 200 triangles),
noise of 0.001 to 0.03 mm, 1 to 10 of 121 nodes anywhere, each in one trial, off by 10 to 300 times
the noise; small strain and neo-Hookean, per cell and per label, all drawn at random. A row per way:
how far the tissue's stiffness, the contrast and the noise are from those of the same displacements
without lost nodes. Run with the environment of the tests:

    python Testing/benchmarks/lost_nodes.py --cases 40
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from elastoidentify import InputError
from elastoidentify.inverse import astray

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
import forward


def figures(case, result):
    """Tissue, contrast, noise of a result."""
    outside = (case.from_edge > 2) & ~case.known
    tissue = np.nanmedian(result.young[outside])
    return np.array([tissue, forward.contrast(case, result), result.report["noise_scale"]])


def drawn(case, seed):
    """Displacements without and with lost nodes, and the options, of one case."""
    random = np.random.default_rng(seed)
    noise = 10 ** random.uniform(-3, -1.5)
    sound = case.noisy(noise, seed + 50)
    count, size = random.integers(1, 11), noise * 10 ** random.uniform(1, 2.5)
    options = {
        "method": "regularized",
        "grouping": str(random.choice(["cell", "label"])),
        "kinematics": str(random.choice(["small-strain", "neo-hookean"])),
    }
    u = sound.copy()
    for node in random.choice(len(case.points), count, replace=False):
        way = random.standard_normal(2)
        u[random.integers(2), node] += size * random.uniform(0.5, 1.5) * way / np.linalg.norm(way)
    return sound, u, options


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--cases", type=int, default=40)
    n, case = parser.parse_args().cases, forward.squares(10)
    sound, cases = {}, {seed: drawn(case, seed) for seed in range(n)}
    for seed, (u, _, options) in cases.items():
        result = forward.found(case, u, **options)
        sound[seed] = figures(case, result), len(result.report["nodes_astray"])
    false = sum(bool(nodes) for _, nodes in sound.values())
    print(f"{n} cases; sound displacements of which some were not believed: {false}\n")
    print("| lost nodes are | tissue off by, median / worst | contrast | noise found | refused | "
          "do not trust | trust |\n|---|---|---|---|---|---|---|")  # fmt: skip
    far = astray.FAR
    for way, limit in (("found", far), ("believed", np.inf)):
        astray.FAR, off, levels, refused = limit, [], [], 0
        for seed, (_, u, options) in cases.items():
            try:
                result = forward.found(case, u, **options)
            except InputError:
                refused += 1
                continue
            levels.append(result.report["verdict"]["level"])
            if levels[-1] != "do not trust":
                off.append(figures(case, result) / sound[seed][0])
        off = np.array(off)
        error = np.abs(off - 1)
        print(f"| {way} | {np.median(error[:, 0]):.1%} / {error[:, 0].max():.0%} | "
              f"{np.nanmedian(error[:, 1]):.1%} / {np.nanmax(error[:, 1]):.0%} | "
              f"{np.median(off[:, 2]):.2f} / {off[:, 2].max():.2g} times | {refused} | "
              f"{levels.count('do not trust')} | {levels.count('trust')} |")  # fmt: skip


if __name__ == "__main__":
    main()
