"""Real images through the whole chain.

    python Testing/benchmarks/real_data.py [tensile foam open_hole ultrasound tpu] --data FOLDER

The images are other people's and not in this repository; FILES has their addresses and checksums.
They are read from the folder that `--data` or ELASTOIDENTIFY_REAL_DATA names; a set whose files are
absent, or others than those that this was written for, is skipped, and it is said why. All sets
have one direction of pull or push and no pad of measured stiffness (a part of the body itself is
declared known); all but the ultrasound have pixels for a unit of length. What is known of each is
in its function.
"""

import argparse
import hashlib
import os
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from elastoidentify import InputError, identify
from elastoidentify.imaging.image import Image
from elastoidentify.imaging.registration import register_radiofrequency
from elastoidentify.pipeline import cell_blocks, make_mesh, measure, run
from elastoidentify.report.picture import draw
from elastoidentify.study import Study
from open_benchmark.methods.strain_image import _axial_strain
from open_benchmark.problem import Case
from scipy import ndimage

MUDIC = "PolymerGuy/muDIC, commit c2c5401, Examples/example_data"
ALDIC = "jyang526843/2D_ALDIC, commit 993a319, Images_Quadtree_demo/Images_foam_stretch"
OPENCORR = "vincentjzy/OpenCorr, commit 44532cc, examples/2d_dic"
ZAYED = "AbdelrahmanZayed/PCA-GLUE_Ultrasound_Elastography, commit 3dfcd5e"
HASHEMI = (
    "sepehrgh98/Ultrasound-Elastography-A-Dynamic-Programming-Approach, commit 9493cef, RFData"
)
JAILIN = "cjailin/Experimental_PANN_learning, commit 679fb50, DVC_data"
FILES = {
    "ut_151.tif": (MUDIC, "bab64317505b2032a4d277f693456a65cd9c1d2a248a803cca3b8dcd8e3548b8"),
    "ut_155.tif": (MUDIC, "8f97acd0be1b8450df7808e5354f1526c9ecaa71218cbd29732401d159a3d6d0"),
    "ut_170.tif": (MUDIC, "866d0248179d578997ca982647fd5b4264df3e24d47c90d4f20e9e25904675a1"),
    "dit155_0p01_3_1_3hz_000001.tif": (
        ALDIC,
        "71f937b0c2eb2c927c14a0bfbcbeae2d4b1fa9e40b6e48297f5b5a1d22f4532d",
    ),
    "dit155_0p01_3_1_3hz_000021.tif": (
        ALDIC,
        "d2ade22a48f19499bd13f82be54290b71e62491f045ff1915ea5608b70c06b05",
    ),
    "ImgMask_dit155_0p01_3_1_3hz_100001.tif": (
        f"{ALDIC}/maskfile",
        "4cfc3b32104b4a28887435e33bf8063f733401b1ef51d419ede0174b1f7e354c",
    ),
    "oht_cfrp_0.bmp": (
        OPENCORR,
        "57d76b1fa96963a9910f94980c3058c1c8a7f6412d38f542dedfa71868d71541",
    ),
    "oht_cfrp_4.bmp": (
        OPENCORR,
        "3bfddc069e5ee6f99babc559a9f0c86dd63930dd7a4f842b0d52740e9ca1196b",
    ),
    "oht_cfrp_4_fftcc_icgn1_r16.csv": (
        OPENCORR,
        "274ceb5ebae776b3dc2c11cb6d56bf5e0bfa4bae7a4df3f905ad964a0570f476",
    ),
    "248_layer0_idx248_BDATA_BF.mat": (
        ZAYED,
        "9f6cd49f67916f633d67a77bbd3fff6ffc1b1388e80f86a79221676218fa8b96",
    ),
    "253_layer0_idx253_BDATA_BF.mat": (
        ZAYED,
        "9d91b0869c4c7da0706b6f2076b358b40e09467934fdaaa12e0c1bbecb73edd4",
    ),
    "359_layer0_idx359_BDATA_BF.mat": (
        ZAYED,
        "b978fe5f74e05318a4ef1ed88ae8a4fd792525fe345da75781d3bc1af2db8741",
    ),
    "392_layer0_idx392_BDATA_BF.mat": (
        ZAYED,
        "cd026cc924f7185ee59714fb75f22b9b0907894a4ccaeaa7ec4f209ada4ac07f",
    ),
    "rf01.mat": (HASHEMI, "c674e46d5cfd6154e7ea1578dde08a8c3a2d906fc1567c8fd2bcfc73cd196482"),
    "rf03.mat": (HASHEMI, "90e7c429dbcf7f70e6f9121f0f60741ed07d78b1160525ae36edd53147c2d926"),
    "connectivity_scan1.csv": (
        JAILIN,
        "df9cb4fc36e5ab8bc672518582931613dcb04530cf247a9015ecf966088e7504",
    ),
    "coordinates_scan1.csv": (
        JAILIN,
        "8ed58524cfbff2858ca320f469c526947f21057ce5703302f5bcbeea1cc2efa3",
    ),
    "displacements_scan1-1.csv": (
        JAILIN,
        "d3e893b416adb3d4ae6fbd20f20c603557c78641a737d1f6cdf9bf4fea74e1de",
    ),
}
PAD, REST, LESION = 1, 2, 3


class Skip(Exception):
    """A set that cannot be had here; the text says why."""


@dataclass(frozen=True)
class Pair:
    """Images of one set, its labels (rows, columns), and how it is identified."""

    rest: np.ndarray
    pushed: list
    labels: np.ndarray
    edge: float
    options: dict = field(default_factory=dict)
    spacing: tuple = (1.0, 1.0, 1.0)

    def study(self, **more) -> Study:
        def image(pixels):
            return Image(pixels, spacing=self.spacing)

        rest, *pushed = (image(one.astype(np.float32)) for one in (self.rest, *self.pushed))
        options = {"length_unit": "px", "unit": "kPa", "plane": "stress", "method": "regularized"}
        options |= {"edge_length": self.edge, "segmentation": image(self.labels)} | self.options
        return Study(rest=rest, pushed=pushed, **options | more)


class Folder:
    """The files that were fetched by the reader."""

    def __init__(self, path):
        self.path = path

    def __call__(self, name: str) -> Path:
        """Return the path of a file that is the right one."""
        origin, checksum = FILES[name]
        file = Path(self.path or ".") / name
        if not (self.path and file.exists()):
            raise Skip(f"{name} is not in --data; it is in the repository {origin}")
        if hashlib.sha256(file.read_bytes()).hexdigest() != checksum:
            raise Skip(f"{name} is another file than that of {origin}")
        return file

    def grey(self, name: str) -> np.ndarray:
        from PIL import Image as Picture

        return np.array(Picture.open(self(name)).convert("L")).astype(float)


# ---- the sets


def tensile(folder: Folder, step: str = "ut_170.tif", poisson: float = 0.49) -> Pair:
    """A metal strip in tension (MIT): the axial strain is alike across, the force along the strip.

    So E does not vary across, and goes as 1/strain along. The strip spreads by 0.52 of its stretch.
    """
    rest, pushed = (folder.grey(name)[500:1500, 200:660] for name in ("ut_151.tif", step))
    slope = ndimage.generic_gradient_magnitude(rest, ndimage.sobel)
    columns = np.flatnonzero((ndimage.gaussian_filter(slope, 8) > 60).mean(axis=0) > 0.9)
    left, right = columns.min() + 8, columns.max() - 8
    labels = np.zeros(rest.shape, np.uint8)
    labels[:, left:right] = REST
    labels[:250, left:right] = PAD
    return Pair(rest, [pushed], labels, 14.0, _young(70.0, poisson))


def foam(folder: Folder, pad: str = "top", poisson: float = 0.2) -> Pair:
    """A strip of one foam with five holes, in tension (BSD-2): E is the pad's everywhere."""
    rest = _halved(folder.grey("dit155_0p01_3_1_3hz_000001.tif"))
    pushed = _halved(folder.grey("dit155_0p01_3_1_3hz_000021.tif"))
    mask = folder.grey("ImgMask_dit155_0p01_3_1_3hz_100001.tif")
    body = np.pad(_halved(ndimage.gaussian_filter(mask, 12)) > 25, 9, mode="edge")
    body = ndimage.binary_opening(ndimage.binary_closing(body, iterations=3), iterations=3)
    body = body[9:-9, 9:-9]
    body[:12, :160] = False  # the mask has a stray strip there
    pieces, n = ndimage.label(body)
    body = pieces == 1 + np.argmax(ndimage.sum(body, pieces, range(1, n + 1)))
    height = np.arange(body.shape[0])[:, None] / body.shape[0]
    labels = REST * body.astype(np.uint8)
    labels[body & ((height < 0.3) if pad == "top" else (height > 0.7))] = PAD
    return Pair(rest, [pushed], labels, 24.0, _young(100.0, poisson))


def open_hole(folder: Folder) -> Pair:
    """A plate of carbon fibre with a hole, in tension; the displacements of a peer are known."""
    rest, pushed = folder.grey("oht_cfrp_0.bmp"), folder.grey("oht_cfrp_4.bmp")
    dark, n = ndimage.label(ndimage.gaussian_filter(rest, 6) < 40)
    size = ndimage.sum(dark > 0, dark, range(1, n + 1))
    y0, x0 = ndimage.center_of_mass(dark == 1 + np.argmax(size))
    y, x = np.indices(rest.shape)
    labels = np.where(np.hypot(x - x0, y - y0) < np.sqrt(size.max() / np.pi) + 3, 0, REST)
    labels[(labels == REST) & (y < 200)] = PAD
    return Pair(rest, [pushed], labels.astype(np.uint8), 12.0, _young(50.0, 0.3))


PHANTOMS = {
    # files; mm from line to line; centre of the lesion (sample, line) and its radii; samples used
    "z": (
        [f"{n}_layer0_idx{n}_BDATA_BF.mat" for n in (248, 253, 359, 392)],
        0.1, (1315, 188), (225, 48), (80, 2140), 1.4,
    ),
    "r": (["rf01.mat", "rf03.mat"], 0.075, (1000, 247), (280, 72), (150, 1700), 1.2),
}  # fmt: skip
SAMPLE, EVERY = 0.01925, 4  # mm from sample to sample; of which one in so many is kept


def ultrasound(folder: Folder, name: str) -> Pair:
    """A phantom with one stiffer lesion, pushed by the probe: log-envelopes of radiofrequency data.

    The uppermost fifth is declared known. Nobody has published what the contrast is: 20 kPa and at
    least twice as stiff ("z", CIRS 059), 33 and 56 kPa ("r"), from memory.
    """
    files, line, centre, radii, (top, bottom), edge = PHANTOMS[name]
    frames = [_envelope(frame(folder(file)), top, bottom) for file in files]
    rows = top + EVERY * np.arange(len(frames[0]))[:, None]
    lines = np.arange(frames[0].shape[1])
    labels = np.full(frames[0].shape, REST, np.uint8)
    labels[rows[:, 0] < top + 0.2 * (bottom - top)] = PAD
    inside = ((rows - centre[0]) / radii[0]) ** 2 + ((lines - centre[1]) / radii[1]) ** 2 < 1
    labels[inside] = LESION
    options = _young(20.0, 0.45) | {"length_unit": "mm", "plane": "strain"}
    return Pair(frames[0], frames[1:], labels, edge, options, (line, SAMPLE * EVERY, 1.0))


def frame(file) -> np.ndarray:
    """Return the radiofrequency data of a file, (samples, lines)."""
    from scipy.io import loadmat

    arrays = [v for key, v in loadmat(file).items() if not key.startswith("__")]
    data = max((v for v in arrays if v.ndim == 2 and v.dtype.kind in "if"), key=np.size)
    return data.astype(float)


def _envelope(data, top, bottom):
    """Envelope of radiofrequency data in dB, one in EVERY samples."""
    from scipy.signal import hilbert

    size = ndimage.gaussian_filter1d(np.abs(hilbert(data, axis=0)), EVERY / 2, axis=0)
    size = size[top:bottom:EVERY]
    return np.clip(20 * np.log10(size / np.percentile(size, 99.5) + 1e-3) + 50, 0, 60)


def _young(young, poisson):
    return {
        "known_materials": [(PAD, young, poisson)],
        "unknowns": "young",
        "poisson_ratio": poisson,
    }


def _halved(image):
    rows, columns = (n // 2 * 2 for n in image.shape)
    return image[:rows, :columns].reshape(rows // 2, 2, columns // 2, 2).mean(axis=(1, 3))


# ---- what comes out


def one_map(name: str, pair: Pair, out: Path | None, registration=None, **more):
    """Identify, print what is needed to judge, draw; return the Outcome."""
    study = pair.study(**more)
    outcome = run(study, registration=registration)
    result, unknown = outcome.result, outcome.mesh.labels != PAD
    E = result.young[unknown] / study.known_materials[0][1]
    finite = np.isfinite(E)
    within = np.abs(E - 1) <= 2 * result.young_std[unknown] / study.known_materials[0][1]
    print(
        f"\n{name}: {len(unknown)} cells, {finite.mean():.0%} found, median E/E_pad "
        f"{np.nanmedian(E):.3f}, coefficient of variation {np.nanstd(E) / np.nanmean(E):.2f}, "
        f"off by more than half {(np.abs(E[finite] - 1) > 0.5).mean():.0%}, "
        f"1 within two stated std {within[finite].mean():.0%}",
        f"verdict: {result.report['verdict']['sentence']}",
        *(f"warning: {one}" for one in outcome.warnings),
        sep="\n",
        flush=True,
    )
    if out is not None and study.grouping == "cell":
        _picture(out, name, study, outcome.mesh, result)
    return outcome


def _picture(out, name, study, mesh, result):
    """Draw a map, the borders between the labels of `mesh` over it."""
    arrays = {
        "Label": mesh.labels,
        "Mu": result.mu,
        "MuStd": result.mu_std,
        "Lambda": result.lam,
        "Status": result.status,
    }
    draw(
        out / f"{''.join(c if c.isalnum() else '_' for c in name)}.png", mesh.points,
        cell_blocks(mesh.cells), arrays, study.rest, unit="kPa", length=study.length_unit,
    )  # fmt: skip


def show_tensile(folder, out):
    known = tensile(folder)
    outcome = one_map("tensile strip, ν = 0.49", known, out)
    _bands(outcome)
    wrong = tensile(folder, poisson=0.33)
    _bands(one_map("tensile strip with a wrong ν, 0.33", wrong, out, outcome.registration))
    free = {"unknowns": "lambda-mu", "poisson_ratio": None}
    _bands(one_map("tensile strip, ν unknown", wrong, out, outcome.registration, **free))


def _bands(outcome, height=100):
    """Print E along the strip beside what statics says, and core over sides."""
    mesh, young = outcome.mesh, outcome.result.young
    centre, E_pad = mesh.points[mesh.cells].mean(axis=1), np.nanmean(young[mesh.labels == PAD])
    x, y = mesh.points[:, 0], mesh.points[:, 1]
    u = outcome.displacements[0][:, 1]

    def strain(low, high):
        inside = (y >= low) & (y <= high)
        return np.polyfit(y[inside], u[inside], 1)[0]

    pad = strain(y.min(), 250)
    rows = []
    for low in range(300, 1000, height):
        in_band = (centre[:, 1] >= low) & (centre[:, 1] < low + height)
        found = np.nanmedian(young[in_band]) if in_band.any() else np.nan
        rows.append((found, E_pad * pad / strain(low, low + height)))
    found, statics = np.array(rows).T
    share = (centre[:, 0] - x.min()) / np.ptp(x)
    lower = mesh.labels != PAD
    core = np.nanmedian(young[lower & (abs(share - 0.5) < 1 / 6)])
    sides = np.nanmedian(young[lower & (abs(share - 0.5) > 1 / 3)])
    print("bands, found:  ", *np.round(found, 1))
    print("bands, statics:", *np.round(statics, 1))
    print(
        f"largest difference {np.nanmax(abs(found / statics - 1)):.1%}; core {core:.1f}, ", end=""
    )
    print(f"sides {sides:.1f}", flush=True)


def show_foam(folder, out):
    for pad in ("top", "bottom"):
        pair = foam(folder, pad)
        outcome = one_map(f"foam with the pad at the {pad}, per cell", pair, out)
        one_map(f"foam, pad at the {pad}, per label", pair, out, outcome.registration,
                grouping="label")  # fmt: skip


def show_open_hole(folder, out):
    pair = open_hole(folder)
    study = pair.study()
    mesh = make_mesh(study)
    found = measure(study, mesh.points, mesh.cells, reaction_nodes=mesh.reaction_nodes)
    compare(mesh.points, found.displacements[0], folder)
    one_map("open hole, per label", pair, out, found, grouping="label")
    one_map("open hole, per cell", pair, out, found)


def show_ultrasound(folder, out):
    for name in PHANTOMS:
        pair = ultrasound(folder, name)
        study = pair.study(grouping="label")
        mesh = make_mesh(study)
        touched = {"reaction_nodes": mesh.reaction_nodes}
        rest, *pushed = _waves(folder, name)
        ways = {
            "envelopes": measure(study, mesh.points, mesh.cells, **touched),
            "radiofrequency": register_radiofrequency(
                "j", rest, pushed, mesh.points, mesh.cells, **touched
            ),
        }
        for way, found in ways.items():
            for kinematics in ("small-strain", "neo-hookean"):
                study = pair.study(grouping="label", kinematics=kinematics)
                _lesion(f"phantom {name}, {way}, {kinematics}, per label", study, mesh, found)
            hidden = replace(mesh, labels=np.where(mesh.labels == LESION, REST, mesh.labels))
            study = pair.study(kinematics="neo-hookean")
            title = f"phantom {name}, {way}, per cell, no label shows it"
            outcome = _lesion(title, study, hidden, found, mesh)
            if out is not None and outcome is not None:
                _picture(out, f"ultrasound {name} {way}", study, mesh, outcome.result)


def _waves(folder, name) -> list[Image]:
    """Return the frames themselves, of the part of the image that is meshed."""
    files, line, _, _, (top, bottom), _ = PHANTOMS[name]
    size = [line, SAMPLE, 1.0]
    return [Image(frame(folder(file))[top:bottom], spacing=size) for file in files]


def _lesion(name, study, mesh, found, shown=None):
    """Print the contrast of the lesion, and what is said; return the Outcome."""
    labels = (shown or mesh).labels
    try:
        outcome = run(study, mesh=mesh, registration=found)
    except InputError as refused:
        print(f"\n{name}: {refused}", flush=True)
        return None
    young = outcome.result.young
    strip, rest, lesion = (np.nanmedian(young[labels == one]) for one in (PAD, REST, LESION))
    u = outcome.displacements[..., :2]
    unknown = np.full((len(labels), 2), np.nan)
    axial = _axial_strain(
        Case(mesh.points[:, :2], "triangle", mesh.cells, u, mesh.reaction_nodes, unknown)
    )
    ratio = np.median(axial[labels == REST]) / np.median(axial[labels == LESION])
    lost = outcome.result.report["nodes_astray"]
    print(
        f"\n{name}: {len(labels)} cells, lesion over background {lesion / rest:.2f} (ratio of the "
        f"axial strains {ratio:.2f}), background over strip {rest / strip:.2f}, lost nodes "
        f"{len(lost)} of {len(mesh.points)}",
        f"verdict: {outcome.result.report['verdict']['sentence']}",
        *(f"warning: {one}" for one in outcome.warnings),
        sep="\n",
        flush=True,
    )
    return outcome


def compare(points, u, folder):
    """Print how far displacements (n, 3) at nodes are from those of OpenCorr (ICGN, radius 16)."""
    from scipy.interpolate import LinearNDInterpolator
    from scipy.spatial import cKDTree

    table = np.genfromtxt(folder("oht_cfrp_4_fftcc_icgn1_r16.csv"), delimiter=",", names=True)
    good = (table["ZNCC"] > 0.9) & (table["convergence"] < 1e-2)
    places = np.column_stack([table["x"], table["y"]])[good]
    peer = LinearNDInterpolator(places, np.column_stack([table["u"], table["v"]])[good])
    near = cKDTree(places).query(points[:, :2])[0] < 3
    difference = (u[:, :2] - peer(points[:, :2]))[near]
    for axis, one in zip("uv", difference.T, strict=True):
        one = one[np.isfinite(one)]
        print(
            f"{axis}, ours − OpenCorr at {len(one)} nodes: mean {one.mean():+.4f} px, standard "
            f"deviation {one.std():.4f}, 95 % within {np.percentile(abs(one), 95):.3f}",
            flush=True,
        )


def show_tpu(folder, out):
    """A pulled block of printed TPU, measured by others in volumes (X-ray, DVC): one material.

    Their tetrahedra with a displacement at every node, the first of four steps (8.5 % along z). A
    quarter of the block is declared known, at either end.
    """
    points, cells, u = (
        np.genfromtxt(folder(f"{name}.csv"), delimiter=",")
        for name in ("coordinates_scan1", "connectivity_scan1", "displacements_scan1-1")
    )
    cells, u = cells.astype(int), u[:, :3]
    height = (points[:, 2] - points[:, 2].min()) / np.ptp(points[:, 2])
    held = np.abs(height - 0.5) > 0.47
    for end, pad in (("upper", height[cells].mean(axis=1) > 0.75),
                     ("lower", height[cells].mean(axis=1) < 0.25)):  # fmt: skip
        for poisson, std in ((0.3, 0.0), (0.4, 0.1)):
            found = identify(
                points, [("tetra", cells)], u[None], np.where(pad[:, None], [1.0, poisson], np.nan),
                labels=np.where(pad, PAD, REST), grouping="label", method="regularized",
                unknowns="young", poisson_ratio=poisson, poisson_std=std, reaction_nodes=held,
                kinematics="neo-hookean",
            )  # fmt: skip
            row = next(one for one in found.statistics if one["label"] == REST)
            young, error, ratio = (
                row[name]
                for name in (
                    "YoungModulus mean",
                    "YoungModulus standard error",
                    "PoissonRatio mean",
                )
            )
            print(
                f"tpu, {end} quarter known with ν {poisson}, rest's ν ± {std}: {len(cells)} cells, "
                f"E of the rest {young:.3f} ± {error:.3f}, ν {ratio:.2f}, noise "
                f"{found.report['noise_found']:.2f}\nverdict: "
                f"{found.report['verdict']['sentence']}",
                flush=True,
            )


SETS = {
    "tensile": show_tensile,
    "foam": show_foam,
    "open_hole": show_open_hole,
    "ultrasound": show_ultrasound,
    "tpu": show_tpu,
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sets", nargs="*", choices=[*SETS, []], default=list(SETS))
    parser.add_argument("--data", default=os.environ.get("ELASTOIDENTIFY_REAL_DATA"))
    parser.add_argument("--pictures", type=Path, help="folder for the pictures of the maps")
    options = parser.parse_args()
    if options.pictures:
        options.pictures.mkdir(parents=True, exist_ok=True)
    for name in options.sets:
        try:
            SETS[name](Folder(options.data), options.pictures)
        except Skip as reason:
            print(f"{name} skipped: {reason}", file=sys.stderr)


if __name__ == "__main__":
    main()
