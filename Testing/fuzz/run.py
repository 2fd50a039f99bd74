"""Throw damaged files at the readers: ``python Testing/fuzz/run.py [--count 10000] [--seed 1]``.

What must hold for each: the file is read, or refused by an InputError of one line; nothing else is
raised, the process does not end, nothing takes longer than a minute, nothing is printed by a
library on our behalf, and a file cut at its end, where a length or checksum shows it, is not read.

The work is done by a process that notes each case before it begins; when that process dies or hangs
the case is counted and another process goes on behind it.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
import mutate  # noqa: E402

LONGEST = 60.0  # seconds
MEMORY = 6 << 30  # bytes that a case may take


def read(sample: mutate.Sample, path: Path):
    """Read a file as the commands do, and use what was read."""
    from elastoidentify.imaging.io import read_image, read_segmentation
    from elastoidentify.imaging.registration import sources
    from elastoidentify.vtk_io import arrays, checks, convert
    from elastoidentify.vtk_io.vtu import read_mesh

    nodes = np.array([[x, y, 0.0] for x in (1.0, 4, 7, 10) for y in (1.0, 4, 7, 10)])
    if sample.kind == "image":
        image = read_image(path)
        return image.array.shape, float(np.nansum(image.array)), image.axes.tolist()
    if sample.kind == "segmentation":
        image, names = read_segmentation(path)
        return image.array.shape, float(np.nansum(image.array)), sorted(names.items())
    if sample.kind == "mesh":
        grid, _ = checks.sound_mesh(read_mesh(path))
        names = convert.displacement_names(grid)
        for name in names:
            arrays.displacement_of(grid, name)
        checks.reaction_nodes(grid)
        checks.information(grid, names)
        return convert.mesh_points(grid).sum(), convert.get_text(grid, "IdentificationReport")
    reader = getattr(sources, f"displacement_from_{sample.kind}")
    return float(reader(path, nodes, noise=0.1).displacement.sum())


def case(all_samples, number: int, seed: int, folder: Path) -> str | None:
    """Do one case. Returns what went wrong, None when nothing did."""
    from elastoidentify.errors import InputError

    for entry in folder.iterdir():
        entry.unlink()
    random = np.random.default_rng([seed, number])
    sample = all_samples[number % len(all_samples)]
    content = sample.files[sample.name]
    damaged, kind = mutate.damage(content, random)
    for name, whole in sample.files.items():
        (folder / name).write_bytes(damaged if name == sample.name else whole)
    started = time.monotonic()
    asked = next(iter(sample.files)) if len(sample.files) == 1 else _asked(sample)
    try:
        read(sample, folder / asked)
    except InputError as error:
        if "\n" in str(error):
            return f"{kind}: more than one line: {error}"
    except Exception as error:
        return f"{kind}: {type(error).__name__}: {str(error)[:200]}"
    else:
        if kind == "cut" and sample.checked and len(damaged) < len(content) - 1:
            return f"cut to {len(damaged)} of {len(content)} bytes and read"
    if time.monotonic() - started > LONGEST:
        return f"{kind}: took {time.monotonic() - started:.0f} s"
    left = {entry.name for entry in folder.iterdir()} - set(sample.files)
    if left:
        return f"{kind}: left {sorted(left)}"
    return None


def _asked(sample: mutate.Sample) -> str:
    """Return the header of a pair, whichever of the two is damaged."""
    return next(name for name in sample.files if name.endswith(("hdr", "mhd")))


def work(numbers: range, seed: int) -> None:
    """Do cases, one line of JSON each before and after; called in a process of its own."""
    import resource

    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    with tempfile.TemporaryDirectory() as top:
        made, folder = Path(top) / "made", Path(top) / "case"
        made.mkdir()
        folder.mkdir()
        all_samples = mutate.samples(made)
        for sample in all_samples:  # undamaged they are read
            for name, whole in sample.files.items():
                (folder / name).write_bytes(whole)
            read(sample, folder / _asked(sample) if len(sample.files) > 1 else folder / sample.name)
            for name in sample.files:
                (folder / name).unlink()
        printed = os.dup(2)
        out = os.fdopen(os.dup(1), "w")
        for number in numbers:
            out.write(json.dumps({"begins": number}) + "\n")
            out.flush()
            with tempfile.TemporaryFile() as noise:
                sys.stdout.flush()
                os.dup2(noise.fileno(), 1)
                os.dup2(noise.fileno(), 2)
                wrong = case(all_samples, number, seed, folder)
                sys.stdout.flush()
                os.dup2(printed, 2)
                noise.seek(0)
                said = noise.read().decode(errors="replace").strip()
            name = all_samples[number % len(all_samples)].name
            if wrong is None and said:
                wrong = f"a library printed: {said.splitlines()[0][:160]}"
            out.write(json.dumps({"ends": number, "wrong": wrong, "name": name}) + "\n")
            out.flush()


def fuzz(count: int, seed: int, start: int = 0) -> list[str]:
    """Do `count` cases, over as many processes as they end. Returns what went wrong."""
    found, number = [], start
    while number < start + count:
        process = subprocess.Popen(
            [sys.executable, __file__, "--work", str(number), str(start + count), str(seed)],
            stdout=subprocess.PIPE,
            text=True,
        )
        begun = None
        for line in process.stdout:
            message = json.loads(line)
            if "begins" in message:
                begun = message["begins"]
                continue
            begun, number = None, message["ends"] + 1
            if message["wrong"]:
                found.append(f"case {message['ends']} ({message['name']}): {message['wrong']}")
        code = process.wait()
        if begun is not None:
            found.append(f"case {begun}: the process ended with code {code}")
            number = begun + 1
        elif code:
            raise RuntimeError(f"the fuzzer itself failed with code {code}")
    return found


def main() -> int:
    """Do the cases asked for and print what went wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--start", type=int, default=0, help="number of the first case")
    parser.add_argument("--work", nargs=3, type=int, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.work:
        first, last, seed = arguments.work
        work(range(first, last), seed)
        return 0
    started = time.monotonic()
    found = fuzz(arguments.count, arguments.seed, arguments.start)
    for line in found:
        print(line)
    kinds = Counter(line.split(": ", 1)[1].split(":")[0] for line in found)
    seconds = time.monotonic() - started
    print(f"{arguments.count} damaged files in {seconds:.0f} s: {len(found)} wrong {dict(kinds)}")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
