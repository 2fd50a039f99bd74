"""The programs in the middle of the pages run as they stand.

Those of the gallery are tested beside; those for ParaView and 3D Slicer in
test_page.py where these hosts are.
"""

import re
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]


def programs(page: str) -> list[str]:
    """Return the Python blocks of a page."""
    text = (ROOT / page).read_text(encoding="utf-8")
    return re.findall(r"^```python\n(.*?)^```", text, re.M | re.S)


def test_the_program_of_the_readme_finds_the_moduli():
    (program,) = programs("README.md")
    names = {}
    exec(program, names)
    np.testing.assert_allclose(names["result"].mu, 1748.3, rtol=1e-4)  # E = 5000 Pa, ν = 0.43


def test_the_programs_of_meshing_and_registration_go_from_images_to_displacements(
    tmp_path, monkeypatch
):
    """On images whose registrations are known: elastix is left out."""
    pytest.importorskip("SimpleITK")
    from elastoidentify.imaging.io import write_image
    from elastoidentify.imaging.phantom import make_phantom
    from elastoidentify.imaging.registration.registration import register
    from stored_registration import TrueDisplacements

    body = make_phantom(width=60, pixels=72, elements=24)
    for name, image in zip(
        ("labels", "rest", "push1", "push2"),
        (body.segmentation, body.rest, *body.pushed),
        strict=True,
    ):
        write_image(tmp_path / f"{name}.nrrd", image)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(register.__kwdefaults__, "elastix", TrueDisplacements(body))
    names = {}
    for page in ("docs/meshing.md", "docs/registration.md"):
        (program,) = programs(page)
        exec(program, names)
    mesh, found = names["mesh"], names["found"]
    assert set(np.unique(mesh.labels)) == {1, 2, 3, 5}  # 4, the indenter, is rigid
    tissue = np.unique(mesh.cells[mesh.labels == 2])
    miss = found.displacements - body.displacements(mesh.points)
    assert np.sqrt((miss[:, tissue] ** 2).sum(-1).mean()) < 0.2 * body.rest.spacing[0]


def test_the_program_of_the_theory_prints_the_figures_of_its_table(capsys):
    """Of exact displacements the errors are round-off, which differs between machines."""
    (program,) = programs("docs/theory.md")
    exec(program, {})
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    found = {(row[0], row[1]): (float(row[2]), int(row[3])) for row in rows}
    page = (ROOT / "docs" / "theory.md").read_text(encoding="utf-8")
    percent, *lost = re.findall(r"^\| \d+ \| [^|]*\| (\d+) (?:%|of \d+)", page, re.M)
    assert found["4", "0"][0] < 1e-11
    assert found["4", "1e-06"][0] == pytest.approx(float(percent) / 100, rel=0.25)
    counts = [found[n, "1e-06"][1] for n in ("12", "24")]
    assert counts == pytest.approx(list(map(int, lost)), rel=0.1)


def test_every_program_of_a_page_is_run_somewhere():
    elsewhere = {"docs/paraview.md", "docs/slicer.md", "docs/hosts.md", "docs/volumes.md"}
    here = {"README.md", "docs/meshing.md", "docs/registration.md", "docs/theory.md"}
    pages = [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
    with_program = {str(one.relative_to(ROOT)) for one in pages if programs(one)}
    assert with_program == here | elsewhere
