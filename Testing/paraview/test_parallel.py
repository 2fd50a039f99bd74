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


@pytest.mark.parametrize("suffix", [".vtm", ".vtpc"])
def test_four_blocks_on_two_ranks_give_what_one_gives(script, tmp_path, suffix):
    cases = tmp_path / "cases.vtm"
    serial, parallel = tmp_path / f"serial{suffix}", tmp_path / f"parallel{suffix}"
    script("make_blocks.py", cases, what="pvbatch")
    script("blocks.py", cases, serial, KNOWN, what="pvbatch")
    text = script("blocks.py", cases, parallel, KNOWN, what="pvbatch", before=mpirun(2))
    assert "ranks that did a block: 0 to 1" in text

    ours, theirs = blocks_of(serial), blocks_of(parallel)
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
    script("make_blocks.py", cases, "--spoil-the-last", what="pvbatch")
    before = mpirun(ranks) if ranks > 1 else ()
    done = run("pvbatch", HERE / "scripts" / "blocks.py", cases, output, KNOWN, before=before)
    assert done.returncode != 0
    assert "ERROR: LameIdentification: known label 1 does not occur in the mesh" in done.stdout
    assert "done" not in done.stdout.splitlines()
