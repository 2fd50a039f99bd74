"""Displacements of ultrasound phantoms beside those of trackers made for radiofrequency data.

    python Testing/benchmarks/ultrasound_tracking.py [z r known] --data FOLDER [--peer FOLDER]
                                                     [--keep FOLDER]

Ours sees the log-envelopes (real_data.py, whose files and folder `--data` names); "radiofrequency"
is the product's registration of the frames themselves (`--radiofrequency j`). The peers see the
frames. Pairs: "z" 359 to 392 (that of a peer's own example), "r" rf01 to rf03, and "known": frame
359, compressed line by line by a known amount, with noise of a tenth of its size in both.
`--peer` holds what the reader has
fetched, each under its repository's name; what is absent is skipped with a sentence:

- AbdelrahmanZayed/PCA-GLUE_Ultrasound_Elastography, commit 3dfcd5e (no licence): normalised
  cross-correlation, and GLUE, in MATLAB, run by GNU Octave with its package image. Its dynamic
  programming is compiled for Windows: GLUE starts from the correlation, for "r" from the next one.
- sepehrgh98/Ultrasound-Elastography-A-Dynamic-Programming-Approach, commit 9493cef (no licence):
  the displacements of "r" that its authors saved (Results/ex1/DP_2D).
- KitwareMedical/ITKUltrasound 66acb1b, KitwareMedical/ITKStrain 3a41c4e and
  InsightSoftwareConsortium/ITKHigherOrderAccurateGradient ffb1cd4 (Apache-2.0), built here with g++
  and ITK's headers (Debian: libinsighttoolkit5-dev): block matching with its default parameters.

The peers take minutes each: what they find is kept in the folder `--keep`, and used again. Nothing
of theirs is in this repository.

Columns: axial difference in samples of 0.019 mm (mean, standard deviation, 95 % of the places
within) and standard deviation of the lateral one in lines, from the truth or from ours; correlation
of windows of 51 samples and 9 lines of the first frame and the second pulled back (cubic splines);
strain by least squares over 93 samples, beside the lesion and in it: mean beside, ratio of the
means, contrast to noise √(2 (a − b)² / (σₐ² + σ_b²)), mean over standard deviation beside. All at
the same places: those where every tracker has a value.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from elastoidentify.imaging.image import Image
from elastoidentify.imaging.registration import register_radiofrequency
from elastoidentify.imaging.registration.registration import Registration
from elastoidentify.imaging.registration.sources import displacement_from_points
from elastoidentify.pipeline import make_mesh, measure
from real_data import PHANTOMS, SAMPLE, Folder, Skip, _envelope, _lesion, frame, ultrasound
from scipy import ndimage
from scipy.interpolate import LinearNDInterpolator
from scipy.io import loadmat, savemat
from scipy.signal import resample, savgol_filter

FRAMES = {"z": (2, 3), "r": (0, 1), "known": (2, 2)}  # of the files of PHANTOMS
STRAIN, LESION_STRAIN, NOISE = 0.005, 0.0025, 0.1  # of "known"; noise over the frame's own size
LENGTH, WINDOW = 93, (51, 9)  # samples of a strain; samples and lines of a correlation
MARGIN = (100, 24)  # samples and lines at the border that are not looked at
EVERY_PLACE = (10, 4)
PEER_NOISE = 0.5 * SAMPLE  # mm, stated for a peer's displacements
ZAYED = "PCA-GLUE_Ultrasound_Elastography"
HASHEMI = "Ultrasound-Elastography-A-Dynamic-Programming-Approach"
KITWARE = ("ITKUltrasound", "ITKStrain", "ITKHigherOrderAccurateGradient")

OCTAVE = """
pkg load image; warning('off', 'all');
addpath('{peer}'); addpath('{here}'); load('{here}/frames.mat');
"""
CORRELATE = """
[found, rho] = disp_est(first, second, {windows}, 51, 21, 5);
save('-v7', '{here}/found.mat', 'found');
"""
GLUE = """
load('{here}/start.mat'); at = 41:rows(first)-40; of = 16:columns(first)-15;
[axial, lateral] = GLUE(start(at,of), sideways(at,of), first(at,of), second(at,of), 5, 1, 5, 1);
save('-v7', '{here}/found.mat', 'axial', 'lateral');
"""
STAND_INS = {  # for a compiled function, and for one of Octave that refuses what MATLAB's takes
    "step2linear.m": "function y = step2linear(x, m)\n  y = x;\nend\n",
    "imgradientxy.m": "function [gx, gy] = imgradientxy(I, how)\n  [gx, gy] = gradient(I);\nend\n",
}
ITK_MAIN = r"""
#include <fstream>
#include "itkBlockMatchingDisplacementPipeline.h"
using Pipeline = itk::BlockMatching::DisplacementPipeline<signed short>;
static auto read(const char * name, unsigned long nx, unsigned long ny)
{
  auto image = Pipeline::FixedImageType::New();
  Pipeline::FixedImageType::SizeType size = { { nx, ny } };
  image->SetRegions(size);
  image->Allocate();
  std::ifstream(name, std::ios::binary).read((char *)image->GetBufferPointer(), 2 * nx * ny);
  return image;
}
int main(int, char ** argv)
{
  auto first = read(argv[3], atol(argv[1]), atol(argv[2]));
  auto second = read(argv[4], atol(argv[1]), atol(argv[2]));
  auto pipeline = Pipeline::New();
  pipeline->SetFixedImage(first);
  pipeline->SetMovingImage(second);
  pipeline->Update();
  auto out = pipeline->GetOutput();
  auto size = out->GetLargestPossibleRegion().GetSize();
  for (int k : { 0, 1 })
    std::cout << size[k] << " " << out->GetOrigin()[k] << " " << out->GetSpacing()[k] << " ";
  std::ofstream(argv[5], std::ios::binary)
    .write((const char *)out->GetBufferPointer(), 16 * size[0] * size[1]);
}
"""
ITK_LIBRARIES = (
    "ITKCommon", "ITKTransform", "ITKOptimizers", "ITKStatistics", "ITKFFT", "itkvnl_algo",
    "itkvnl", "itkv3p_netlib", "itkvcl", "itksys", "ITKVNLInstantiation",
)  # fmt: skip
ITK_NEWER = (
    "itkOverrideGetNameOfClassMacro(x)=const char *GetNameOfClass() const override {return #x;}"
)


# ---- the frames


def phantom_of(name: str) -> str:
    return "r" if name == "r" else "z"


def frames(folder: Folder, name: str):
    """Return both frames, the true displacement or None, and the Pair for ours."""
    phantom = phantom_of(name)
    first, second = (frame(folder(PHANTOMS[phantom][0][n])) for n in FRAMES[name])
    pair = ultrasound(folder, phantom)
    envelopes = [pair.rest, *pair.pushed]
    pair = replace(pair, rest=envelopes[FRAMES[name][0]], pushed=[envelopes[FRAMES[name][1]]])
    if name != "known":
        return first, second, None, pair
    first, second, truth = compressed(first)
    rest, pushed = (_envelope(one, *PHANTOMS[phantom][4]) for one in (first, second))
    pair = replace(pair, rest=rest, pushed=[pushed])
    return first, second, (truth, np.zeros_like(truth)), pair


def compressed(rest: np.ndarray):
    """Return two noisy frames and the displacement between them: a stiffer lesion, line by line."""
    rows = np.arange(len(rest))
    strain = np.where(_ellipse("z", rest.shape, 1.0), LESION_STRAIN, STRAIN)
    u = -ndimage.gaussian_filter(np.cumsum(strain, axis=0), 8.0)
    finer = resample(rest, 4 * len(rest), axis=0)
    pushed = np.empty_like(rest)
    for line in range(rest.shape[1]):
        origin = np.interp(rows, rows + u[:, line], rows)
        pushed[:, line] = ndimage.map_coordinates(finer[:, line], [4 * origin], mode="nearest")
    rng, size = np.random.default_rng(1), NOISE * rest.std()
    return *(one + size * rng.standard_normal(rest.shape) for one in (rest, pushed)), u


def _ellipse(phantom, shape, size):
    """Where the lesion is, `size` times as large."""
    centre, radii = PHANTOMS[phantom][2:4]
    rows, lines = np.ogrid[: shape[0], : shape[1]]
    return ((rows - centre[0]) / radii[0]) ** 2 + ((lines - centre[1]) / radii[1]) ** 2 < size**2


# ---- the trackers: axial, lateral displacement in samples, lines; (samples, lines); NaN: none


def spread(points, values, shape) -> tuple:
    """Interpolate displacements at places (line, sample) to all samples of a frame."""
    rows, lines = np.indices(shape)
    found = LinearNDInterpolator(points, values)(lines, rows)
    return found[..., 1], found[..., 0]


def ours(pair, phantom: str, shape):
    """Return the mesh, the Registration of the envelopes, and its field."""
    study = pair.study(grouping="label")
    mesh = make_mesh(study)
    found = measure(study, mesh.points, mesh.cells, reaction_nodes=mesh.reaction_nodes)
    return mesh, found, spread(*in_samples(mesh, found, phantom), shape)


def in_samples(mesh, found, phantom):
    """Return nodes and their displacement as (line, sample)."""
    _, line, _, _, (top, _), _ = PHANTOMS[phantom]
    size = np.array([line, SAMPLE])
    return mesh.points[:, :2] / size + (0, top), found.displacements[0][:, :2] / size


def on_the_frames(mesh, phantom, first, second):
    """Return the Registration of the radiofrequency data themselves, and its field."""
    _, line, _, _, (top, bottom), _ = PHANTOMS[phantom]
    rest, pushed = (Image(one[top:bottom], spacing=[line, SAMPLE, 1.0]) for one in (first, second))
    found = register_radiofrequency(
        "j", rest, [pushed], mesh.points, mesh.cells, reaction_nodes=mesh.reaction_nodes
    )
    figures = found.report["trials"][0]
    print(
        f"waves agree by {figures['wave_agreement']:.2f}, not at {figures['nodes_off_wave']} nodes"
    )
    return found, spread(*in_samples(mesh, found, phantom), first.shape)


def correlation(peer, first, second):
    """Zayed and Rivaz: normalised cross-correlation, windows of their example, every 8 samples."""
    step = 8
    windows = len(first) // step
    found = octave(peer, CORRELATE.format(windows=windows, here="{here}"), first, second)["found"]
    middle = 5 + 25 + step * np.arange(windows)
    inside = middle < len(first) - 150  # further down its window leaves the frame: 0
    field = np.full(first.shape, np.nan)
    rows = np.arange(middle[0], middle[inside][-1])
    for line in range(first.shape[1]):
        field[rows, line] = np.interp(rows, middle[inside], found[inside, line])
    return field, np.zeros(first.shape)


def glue(peer, first, second, start):
    """Hashemi and Rivaz: GLUE with the weights of the example, from `start`."""
    axial, lateral = (_filled(ndimage.median_filter(_filled(one), (65, 9))) for one in start)
    found = octave(peer, GLUE, first, second, start=axial, sideways=lateral)
    fields = [np.full(first.shape, np.nan) for _ in "al"]
    for field, name in zip(fields, ("axial", "lateral"), strict=True):
        field[40:-40, 15:-15] = found[name]
        field[np.isnan(start[0])] = np.nan
    return tuple(fields)


def _filled(field):
    """The nearest value in place of each that is none."""
    none = np.isnan(field)
    if not none.any():
        return field
    nearest = ndimage.distance_transform_edt(none, return_distances=False, return_indices=True)
    return field[tuple(nearest)]


def octave(peer, script, first, second, **start) -> dict:
    """Run a script on two frames with a peer's functions; return what it saves."""
    if shutil.which("octave") is None:
        raise Skip("GNU Octave is not installed")
    with tempfile.TemporaryDirectory() as here:
        for name, text in STAND_INS.items():
            (Path(here) / name).write_text(text)
        frames = {"first": first / first.max(), "second": second / second.max()}
        savemat(Path(here) / "frames.mat", frames)
        savemat(Path(here) / "start.mat", start or {"none": 0})
        command = (OCTAVE + script).format(peer=peer, here=here)
        done = subprocess.run(
            ["octave", "--no-gui", "--quiet", "--eval", command], capture_output=True, text=True
        )
        if not (Path(here) / "found.mat").exists():
            raise Skip(f"Octave: {done.stderr.strip()[-300:]}")
        return loadmat(Path(here) / "found.mat")


def block_matching(program, first, second):
    """McCormick et al.: ITKUltrasound's displacement pipeline as it is set up."""
    scale = 3e4 / max(np.abs(first).max(), np.abs(second).max())
    with tempfile.TemporaryDirectory() as here:
        names = [str(Path(here) / name) for name in ("first", "second", "found")]
        for name, one in zip(names, (first, second), strict=False):
            (one.T * scale).astype(np.int16).tofile(name)
        done = subprocess.run(
            [program, *map(str, first.shape), *names], capture_output=True, text=True, check=True
        )
        grid = np.array(done.stdout.split(), float).reshape(2, 3)
        found = np.fromfile(names[2]).reshape(int(grid[1, 0]), int(grid[0, 0]), 2)
    rows, lines = (start + step * np.arange(int(n)) for n, start, step in grid)
    places = np.stack(np.meshgrid(rows, lines), -1).reshape(-1, 2)
    return spread(places[:, ::-1], found.reshape(-1, 2)[:, ::-1], first.shape)


def built(peer: Path, here: str) -> str:
    """Return the program of the block matching, built from the peers' headers."""
    missing = [name for name in KITWARE if not (peer / name / "include").is_dir()]
    toolkit = next(iter(sorted(Path("/usr/include").glob("ITK-5.*"))), None)
    if missing or toolkit is None or shutil.which("g++") is None:
        raise Skip(f"needs g++, ITK's headers and {', '.join(KITWARE)}; absent: {missing}")
    (Path(here) / "main.cxx").write_text(ITK_MAIN)
    (Path(here) / "UltrasoundExport.h").write_text("#define Ultrasound_EXPORT\n")
    (Path(here) / "itkBSplineApproximationGradientImageFilter.h").touch()  # included, not used
    version = toolkit.name.removeprefix("ITK-")
    folders = [here, *(peer / name / "include" for name in KITWARE), toolkit]
    bar = peer / KITWARE[0] / "src" / "itkTextProgressBarCommand.cxx"
    command = ["g++", "-std=c++17", "-O2", "-w", f"-D{ITK_NEWER}", *(f"-I{one}" for one in folders)]
    command += [f"{here}/main.cxx", str(bar), "-o", f"{here}/track", "-lpthread"]
    command += [f"-l{one}-{version}" for one in ITK_LIBRARIES]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise Skip(f"the block matching cannot be built: {done.stderr.strip()[-300:]}")
    return f"{here}/track"


def saved(peer: Path):
    """Ghamari et al.: their saved displacements of "r" by dynamic programming, whole samples."""
    names = ("Axial", "Lateral")
    folder = peer / HASHEMI / "Results" / "ex1" / "DP_2D"
    files = [folder / f"{name}DisplacementMap2D.mat" for name in names]
    if not all(file.exists() for file in files):
        raise Skip(f"no saved displacements in {HASHEMI}")
    return tuple(frame(file) for file in files)


class Peers:
    """The trackers of others; what they find is kept in a folder if one is given."""

    def __init__(self, peer, keep):
        self.peer, self.keep = peer and Path(peer), keep and Path(keep)

    def fields(self, name, first, second) -> dict:
        """Return {tracker: (axial, lateral)} of those that are here."""
        if self.peer is None:
            print("no --peer folder: the trackers of others are skipped", file=sys.stderr)
            return {}
        found, zayed = {}, self.peer / ZAYED
        steps = {"block matching": lambda: self._matched(first, second)}
        if name == "r":
            steps["dynamic programming"] = lambda: _padded(saved(self.peer), first.shape)
        steps["correlation"] = lambda: correlation(zayed, first, second)
        begin = "dynamic programming" if name == "r" else "correlation"
        steps["GLUE"] = lambda: glue(zayed, first, second, self._start(found, begin))
        for tracker, step in steps.items():
            try:
                found[tracker] = self._kept(f"{name} {tracker}", step)
            except Skip as reason:
                print(f"{tracker} skipped: {reason}", file=sys.stderr)
        return found

    def _matched(self, first, second):
        with tempfile.TemporaryDirectory() as here:
            return block_matching(built(self.peer, here), first, second)

    def _start(self, found, begin):
        if begin not in found:
            raise Skip(f"it starts from the {begin}")
        return found[begin]

    def _kept(self, name, step):
        file = self.keep and self.keep / f"{name.replace(' ', '_')}.npy"
        if file and file.exists():
            return tuple(np.load(file))
        found = step()
        if file:
            self.keep.mkdir(parents=True, exist_ok=True)
            np.save(file, found)
        return found


def _padded(fields, shape):
    found = [np.full(shape, np.nan) for _ in fields]
    for one, field in zip(found, fields, strict=True):
        one[: len(field)] = field
    return tuple(found)


# ---- what comes out


def pulled_back(second, field):
    """Return the second frame where the first one's samples went (cubic splines)."""
    rows, lines = np.indices(second.shape)
    axial, lateral = (_filled(one) for one in field)
    return ndimage.map_coordinates(second, [rows + axial, lines + lateral], mode="nearest")


def correlated(first, second, field):
    """Return the correlation of windows of `first` and of `second` pulled back."""
    pulled = pulled_back(second, field)

    def mean(one):
        return ndimage.uniform_filter(one, WINDOW)

    size = np.sqrt(np.maximum(mean(first**2) * mean(pulled**2), 1e-30))
    return mean(first * pulled) / size


def strain_of(axial):
    """Return the compression, by least squares over LENGTH samples."""
    return -savgol_filter(axial, LENGTH, 1, deriv=1, axis=0, mode="constant", cval=np.nan)


def places_of(phantom, strains):
    """Return where to look: a grid in the part that ours sees, wherever all have a strain."""
    chosen = np.zeros(next(iter(strains.values())).shape, bool)
    (top, bottom), (rows, lines) = PHANTOMS[phantom][4], MARGIN
    chosen[top + rows : bottom - rows : EVERY_PLACE[0], lines : -lines : EVERY_PLACE[1]] = True
    for one in strains.values():
        chosen &= np.isfinite(one)
    return chosen


def table(name, first, second, fields, truth):
    """Print the comparison of all trackers, from the truth or from ours."""
    phantom = phantom_of(name)
    strains = {tracker: strain_of(field[0]) for tracker, field in fields.items()}
    at = places_of(phantom, strains)
    lesion = _ellipse(phantom, first.shape, 0.8)
    inside, height = at & lesion, lesion.any(axis=1)[:, None]
    beside = at & height & ~_ellipse(phantom, first.shape, 1.25)
    print(
        f"\n{name}, {at.sum()} places\n| tracker | minus {'ours' if truth is None else 'truth'}: "
        "mean | std | 95 % | lateral | correlation | strain beside | ratio | contrast to noise "
        "| signal to noise |\n|---|---|---|---|---|---|---|---|---|---|"
    )
    for tracker, field in fields.items():
        off, sideways = (
            (one - other)[at] for one, other in zip(field, truth or fields["ours"], strict=True)
        )
        a, b = strains[tracker][beside], strains[tracker][inside]
        contrast = np.sqrt(2 * (a.mean() - b.mean()) ** 2 / (a.var() + b.var()))
        print(
            f"| {tracker} | {off.mean():+.3f} | {off.std():.3f} | "
            f"{np.percentile(np.abs(off), 95):.3f} | {sideways.std():.2f} | "
            f"{correlated(first, second, field)[at].mean():.3f} | {a.mean():.2%} | "
            f"{a.mean() / b.mean():.2f} | {contrast:.2f} | {a.mean() / a.std():.2f} |",
            flush=True,
        )


def brought(mesh, field, phantom) -> Registration:
    """Bring a peer's displacements to the nodes, as a table of measured points would be."""
    _, line, _, _, (top, _), _ = PHANTOMS[phantom]
    rows, lines = np.nonzero(np.isfinite(field[0]))
    few = (rows % EVERY_PLACE[0] == 0) & (lines % EVERY_PLACE[1] == 0)
    rows, lines = rows[few], lines[few]
    zero = np.zeros(len(rows))
    axial, lateral = (one[rows, lines] for one in field)
    values = [line * lines, SAMPLE * (rows - top), zero, line * lateral, SAMPLE * axial, zero]
    found = displacement_from_points(np.column_stack(values), mesh.points, noise=PEER_NOISE)
    report = {"trials": [], "warnings": found.notes}
    return Registration(found.displacement[None], found.information[None], None, report)


def show(name, folder, peers):
    """Print the table of a pair, and the moduli that come of the displacements."""
    first, second, truth, pair = frames(folder, name)
    phantom = phantom_of(name)
    mesh, found, field = ours(pair, phantom, first.shape)
    on_frames, second_field = on_the_frames(mesh, phantom, first, second)
    fields = {"ours": field, "ours, radiofrequency": second_field}
    fields |= peers.fields(name, first, second)
    table(name, first, second, fields, truth)
    if name == "known":  # what no elastic body does: lines that move by themselves have no moduli
        return
    measured = {"ours": found, "ours, radiofrequency": on_frames}
    for tracker in ("block matching", "GLUE"):
        if tracker in fields:
            measured[tracker] = brought(mesh, fields[tracker], phantom)
    study = pair.study(grouping="label", kinematics="neo-hookean")
    for tracker, one in measured.items():
        _lesion(f"{name}, moduli from {tracker}", study, mesh, one)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pairs", nargs="*", choices=[*FRAMES, []], default=list(FRAMES))
    parser.add_argument("--data", default=os.environ.get("ELASTOIDENTIFY_REAL_DATA"))
    parser.add_argument("--peer", help="folder with the repositories of the peers")
    parser.add_argument("--keep", help="folder for what the peers found")
    options = parser.parse_args()
    for name in options.pairs:
        try:
            show(name, Folder(options.data), Peers(options.peer, options.keep))
        except Skip as reason:
            print(f"{name} skipped: {reason}", file=sys.stderr)


if __name__ == "__main__":
    main()
