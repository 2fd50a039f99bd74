"""Compare ways to measure displacements on phantoms whose displacement is known exactly.

    python Testing/benchmarks/registration.py            # two textures, one push, 2 % noise
    python Testing/benchmarks/registration.py --pushes 0.02 0.05 0.12 --noise 0 0.02 0.05

For each method: root mean square error of the displacement at the nodes (pixels) and of the strain
of the cells (percent strain), the modulus ratio inclusion : background that the regularized
identification makes of the displacements (one unknown per label, truth 8; the mesh does not follow
the inclusion's edge, so the exact displacements do not give 8 either), and the time as a multiple
of our default's. A method is "lost" when its displacement error exceeds 1 pixel.

Optional packages: opencv-python-headless (dis), al-dic (aldic). A method whose package is missing
is left out, with a word about it.
"""

import argparse
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator
from scipy.ndimage import map_coordinates

sys.path.insert(0, str(Path(__file__).parents[1] / "imaging"))
import pairs
from elastoidentify import identify
from elastoidentify.imaging.image import Image
from elastoidentify.imaging.registration.registration import register
from elastoidentify.workers.elastix_client import ElastixProcess

LOST = 1.0  # pixels
KNOWN_HEIGHT = 0.25  # the upper quarter of the block is the known material

# elastix's own default B-spline map (GetDefaultParameterMap("bspline")), written out
STOCK = """
(AutomaticParameterEstimation "true")
(CheckNumberOfSamples "true")
(DefaultPixelValue 0)
(FinalGridSpacingInPhysicalUnits 10)
(FixedImagePyramid "FixedSmoothingImagePyramid")
(GridSpacingSchedule 2.8284271247461903 2 1.4142135623730951 1)
(ImageSampler "RandomCoordinate")
(Interpolator "LinearInterpolator")
(MaximumNumberOfIterations 256)
(MaximumNumberOfSamplingAttempts 8)
(Metric "AdvancedMattesMutualInformation" "TransformBendingEnergyPenalty")
(Metric0Weight 1.0)
(Metric1Weight 1.0)
(MovingImagePyramid "MovingSmoothingImagePyramid")
(NewSamplesEveryIteration "true")
(NumberOfResolutions 4)
(NumberOfSamplesForExactGradient 4096)
(NumberOfSpatialSamples 2048)
(Optimizer "AdaptiveStochasticGradientDescent")
(Registration "MultiMetricMultiResolutionRegistration")
(ResampleInterpolator "FinalBSplineInterpolator")
(Resampler "DefaultResampler")
(Transform "BSplineTransform")
(WriteResultImage "true")
"""


def sample(field: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Values (n, 2) of a dense displacement field (nj, ni, 2) at points (n, 2)."""
    return np.stack(
        [map_coordinates(field[..., axis], points.T[::-1], order=1) for axis in range(2)], 1
    )


def bytes_of(image: np.ndarray) -> np.ndarray:
    return np.uint8(np.clip(255 * image, 0, 255))


def elastix_method(worker: ElastixProcess, parameters=None, refine=False) -> Callable:
    """elastix through :func:`register`; also returns the information of the displacements."""

    def measure(rest, pushed, points, cells):
        there = np.c_[points, np.zeros(len(points))]
        found = register(
            Image(rest),
            [Image(pushed)],
            there,
            cells,
            parameters=parameters,
            backward=False,
            refine=refine,
            elastix=worker,
        )
        return found.displacements[0][:, :2], found.information[0]

    return measure


def dis(rest, pushed, points, cells):
    """Dense inverse search optical flow (OpenCV), medium preset."""
    import cv2

    flow = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    return sample(flow.calc(bytes_of(rest), bytes_of(pushed), None), points), None


def demons(rest, pushed, points, cells):
    """Diffeomorphic demons (SimpleITK), three resolutions, 100 iterations each."""
    import SimpleITK as sitk

    fixed, moving = (sitk.GetImageFromArray(np.float32(one)) for one in (rest, pushed))
    moving = sitk.HistogramMatching(moving, fixed)
    method = sitk.DiffeomorphicDemonsRegistrationFilter()
    method.SetNumberOfIterations(100)
    method.SetSmoothDisplacementField(True)
    method.SetStandardDeviations(2.0)
    field = None
    for shrink in (4, 2, 1):
        levels = [
            sitk.Shrink(sitk.SmoothingRecursiveGaussian(one, 0.5 * shrink), [shrink] * 2)
            for one in (fixed, moving)
        ]
        field = (
            method.Execute(*levels)
            if field is None
            else method.Execute(*levels, sitk.Resample(field, levels[0]))
        )
    return sample(sitk.GetArrayFromImage(field), points), None


def aldic(rest, pushed, points, cells):
    """Augmented Lagrangian digital image correlation, window 32, step 8."""
    from al_dic.core.config import dicpara_default
    from al_dic.core.data_structures import GridxyROIRange
    from al_dic.core.pipeline import run_aldic

    low, high = int(pairs.LOW), int(pairs.HIGH)
    mask = np.zeros(rest.shape)
    mask[low : high + 1, low : high + 1] = 1.0
    settings = dicpara_default(
        winsize=32, winstepsize=8, gridxy_roi_range=GridxyROIRange((low, high), (low, high))
    )
    result = run_aldic(settings, [255 * rest, 255 * pushed], [mask, mask], compute_strain=False)
    there, u = result.dic_mesh.coordinates_fem, result.result_disp[0].U.reshape(-1, 2)
    good = np.isfinite(u).all(1)
    found = LinearNDInterpolator(there[good], u[good])(points)
    outside = ~np.isfinite(found).all(1)
    found[outside] = NearestNDInterpolator(there[good], u[good])(points[outside])
    return found, None


def modulus_ratio(points, cells, displacements, information) -> float:
    """Inclusion : background of the regularized identification, one unknown per label."""
    centres = points[cells].mean(1)
    x, y, radius = pairs.INCLUSION
    labels = np.where(np.hypot(centres[:, 0] - x, centres[:, 1] - y) < radius, 2, 1)
    known = centres[:, 1] < pairs.LOW + KNOWN_HEIGHT * (pairs.HIGH - pairs.LOW)
    labels[known & (labels == 1)] = 3
    ends = np.isclose(points[:, 1], pairs.LOW) | np.isclose(points[:, 1], pairs.HIGH)
    full = None
    if all(one is not None for one in information):
        full = np.stack([[[one[:, 0], one[:, 3]], [one[:, 3], one[:, 1]]] for one in information])
        full = np.moveaxis(full, -1, 1)
    result = identify(
        points,
        cells,
        np.stack(displacements),
        {3: (1.0, 0.47)},
        labels=labels,
        reaction_nodes=ends,
        method="regularized",
        unknowns="young",
        poisson_ratio=0.47,
        grouping="label",
        information=full,
    )
    return float(np.median(result.mu[labels == 2]) / np.median(result.mu[labels == 1]))


def run(options, methods: dict[str, Callable]) -> list[dict]:
    """Every method on every phantom. Returns one row per texture, push, noise and method."""
    points, cells = pairs.block_mesh(options.edge)
    rows = []
    for texture in options.textures:
        for push in options.pushes:
            for noise in options.noise:
                phantoms = [
                    pairs.make_pair(texture, direction, push, noise, seed=11)
                    for direction in pairs.DIRECTIONS
                ]
                for name, measure in methods.items():
                    start = time.perf_counter()
                    found = [measure(one.rest, one.pushed, points, cells) for one in phantoms]
                    seconds = time.perf_counter() - start
                    true = [one.displacement(points) for one in phantoms]
                    error = [pairs.rms(u - t) for (u, _), t in zip(found, true, strict=True)]
                    strain = [
                        pairs.strain_error(points, cells, u, t)
                        for (u, _), t in zip(found, true, strict=True)
                    ]
                    row = {"texture": texture, "push": push, "noise": noise, "method": name}
                    row |= {"error": np.mean(error), "strain": np.mean(strain)}
                    row |= {"lost": int(np.sum(np.array(error) > LOST)), "seconds": seconds}
                    row["ratio"] = np.nan
                    if not options.no_moduli and not row["lost"]:
                        row["ratio"] = modulus_ratio(points, cells, *zip(*found, strict=True))
                    rows.append(row)
                    show(row, rows)
                if not options.no_moduli:
                    true = [one.displacement(points) for one in phantoms]
                    ratio = modulus_ratio(points, cells, true, [None] * len(true))
                    print(
                        f"| {texture} | {100 * push:g} % | {100 * noise:g} % | exact displacement"
                        f" | 0 | 0 | {ratio:.2f} | | |",
                        flush=True,
                    )
    return rows


def show(row: dict, rows: list[dict]) -> None:
    """Print one row; time as a multiple of our default's on the same phantom."""
    same = [one for one in rows if all(one[k] == row[k] for k in ("texture", "push", "noise"))]
    times = row["seconds"] / same[0]["seconds"]
    if len(rows) == 1:
        print(
            "| texture | push | noise | method | displacement, px | strain, % | ratio (8) | lost |"
            " time |\n|---|---|---|---|---|---|---|---|---|"
        )
    print(
        f"| {row['texture']} | {100 * row['push']:g} % | {100 * row['noise']:g} % | {row['method']}"
        f" | {row['error']:.3f} | {100 * row['strain']:.2f} | {row['ratio']:.2f} |"
        f" {row['lost']}/2 | {times:.2f} |",
        flush=True,
    )


def available(worker: ElastixProcess, stock: Path, wanted: list[str]) -> dict[str, Callable]:
    """The methods whose packages are installed, our default first."""
    methods = {
        "elastoidentify": elastix_method(worker),
        "elastoidentify, refined": elastix_method(worker, refine=True),
        "elastix stock": elastix_method(worker, stock),
        "dis": dis,
        "demons": demons,
        "aldic": aldic,
    }
    packages = {"dis": "cv2", "aldic": "al_dic.core.pipeline", "demons": "SimpleITK"}
    for name, package in packages.items():
        try:
            __import__(package)
        except ImportError as error:
            print(f"{name} is left out: {error}", file=sys.stderr)
            del methods[name]
    return {
        name: method for name, method in methods.items() if name in [*list(methods)[:2], *wanted]
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--textures", nargs="+", default=["speckle", "mr"])
    parser.add_argument("--pushes", nargs="+", type=float, default=[0.05])
    parser.add_argument("--noise", nargs="+", type=float, default=[0.02])
    parser.add_argument("--edge", type=float, default=12.0, help="edge of the mesh in pixels")
    parser.add_argument("--methods", nargs="+", default=["elastix stock", "dis", "demons", "aldic"])
    parser.add_argument("--no-moduli", action="store_true", help="displacement and strain only")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as folder, ElastixProcess() as worker:
        stock = Path(folder) / "stock.txt"
        stock.write_text(STOCK)
        run(options, available(worker, stock, options.methods))


if __name__ == "__main__":
    main()
