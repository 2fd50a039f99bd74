"""pvbatch on two ranks: every block on the rank that owns it, the same numbers as in serial."""

import numpy as np
import pytest
from paraview_host import HERE, mpirun, run

pytestmark = pytest.mark.slow

KNOWN = "1,5000,0.43"
CELL_ARRAYS = ("Lambda", "Mu", "LambdaStd", "MuStd", "Status", "SequenceOrder", "TrueMu")


def blocks_of(path):
    """The meshes of a file, in order."""
    readers = pytest.importorskip("vtkmodules.vtkIOXML")
    kind = {
        ".vtm": "vtkXMLMultiBlockDataReader",
        ".vtpc": "vtkXMLPartitionedDataSetCollectionReader",
    }[path.suffix]
    reader = getattr(readers, kind)()
    reader.SetFileName(str(path))
    reader.Update()
    leaves, iterator = [], reader.GetOutputDataObject(0).NewIterator()
    iterator.SkipEmptyNodesOn()
    iterator.InitTraversal()
    while not iterator.IsDoneWithTraversal():
        leaves.append(iterator.GetCurrentDataObject())
        iterator.GoToNextItem()
    return [leaf for leaf in leaves if leaf.GetNumberOfCells()]


def arrays(leaf):
    """The results on a mesh by name."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    cells, points = leaf.GetCellData(), leaf.GetPointData()
    found = {name: vtk_to_numpy(cells.GetArray(name)) for name in CELL_ARRAYS}
    for name in ("Residual_1", "Residual_2"):
        found[name] = vtk_to_numpy(points.GetArray(name))
    return found


@pytest.fixture(scope="module")
def solved(blocks, tmp_path_factory):
    """Files of four identified blocks by their names, serial and on two ranks, of both kinds."""
    folder = tmp_path_factory.mktemp("solved")
    for name, before in (("serial", ()), ("parallel", mpirun(2))):
        files = [folder / f"{name}{suffix}" for suffix in (".vtm", ".vtpc")]
        words = (HERE / "scripts" / "blocks.py", blocks, KNOWN, *files)
        done = run("pvbatch", *words, before=before)
        assert done.returncode == 0 and "done" in done.stdout.splitlines(), done.stdout
    said = [line for line in done.stdout.splitlines() if "ranks that did a block" in line]
    assert said == 2 * ["ranks that did a block: 0 to 1"]
    return {file.name: file for file in folder.iterdir()}


@pytest.mark.parametrize("suffix", [".vtm", ".vtpc"])
def test_four_blocks_on_two_ranks_give_what_one_gives(solved, suffix):
    ours, theirs = (blocks_of(solved[name + suffix]) for name in ("serial", "parallel"))
    assert len(ours) == len(theirs) == 4
    for one, other in zip(ours, theirs, strict=True):
        one, other = arrays(one), arrays(other)
        np.testing.assert_allclose(one["Mu"], one["TrueMu"], rtol=0.05)
        for name, values in one.items():
            np.testing.assert_array_equal(other[name], values, err_msg=name)


@pytest.mark.parametrize("ranks", [1, 2])
def test_one_bad_block_ends_the_run_with_an_error(script, tmp_path, ranks):
    """The bad block is the last one: with two ranks it fails where no script runs."""
    cases, output = tmp_path / "cases.vtm", tmp_path / "output.vtm"
    script("make_blocks.py", cases, "--spoil-the-last")
    before = mpirun(ranks) if ranks > 1 else ()
    done = run("pvbatch", HERE / "scripts" / "blocks.py", cases, KNOWN, output, before=before)
    assert done.returncode != 0
    assert "ERROR: LameIdentification: known label 1 does not occur in the mesh" in done.stdout
    assert "done" not in done.stdout.splitlines()
