"""From images of a pad that slides on the tissue to the map."""

import numpy as np
import pytest
from elastoidentify import pipeline
from elastoidentify.imaging.meshing import mesh_segmentation
from elastoidentify.imaging.phantom import make_phantom
from elastoidentify.study import Study

PAD, TISSUE = 1, 2


@pytest.fixture(scope="module")
def phantom():
    """A pad that slides by up to 5 px on either side of the middle, and a lesion without label."""
    pytest.importorskip("skfem")
    made = make_phantom(slip=True, elements=32, pixels=144, seed=1, pushes=[(0.0, 0.05)])
    labels = made.segmentation.array
    hidden = made.segmentation.with_array(np.where(labels == 3, TISSUE, labels))
    return made, hidden


def truth(phantom, mesh):
    """The displacements of every node with the cells that it belongs to."""
    middle = np.zeros_like(mesh.points)
    count = np.bincount(mesh.cells.ravel())[:, None]
    centres = np.repeat(mesh.points[mesh.cells].mean(axis=1), mesh.cells.shape[1], axis=0)
    np.add.at(middle, mesh.cells.ravel(), centres)
    return phantom.displacements(mesh.points + 1e-4 * (middle / count - mesh.points))


def study(phantom, hidden, **more):
    return Study(
        segmentation=hidden, rest=phantom.rest, pushed=phantom.pushed, edge_length=10.0,
        rigid_labels=phantom.rigid_labels, known_materials={PAD: (5000.0, 0.45)}, **more,
    )  # fmt: skip


def test_the_phantoms_pad_slides_and_does_not_part(phantom):
    made, _ = phantom
    height = 0.25 * made.frame.height
    x = np.linspace(0.05, 0.95, 10) * made.frame.width
    above, below = (
        made.deformations[0](np.column_stack([x, np.full(10, height + side)]))
        for side in (-1e-6, 1e-6)
    )
    assert np.ptp(above[:, 0] - below[:, 0]) > 2.0
    assert np.allclose(above[:, 1], below[:, 1], atol=1e-3)


def test_the_mesh_is_split_between_labels_that_slide(phantom):
    made, hidden = phantom
    mesh = mesh_segmentation(hidden, 10.0, rigid_labels=made.rigid_labels, slip=[(PAD, TISSUE)])
    one, other = (set(mesh.cells[mesh.labels == label].ravel()) for label in (PAD, TISSUE))
    assert not one & other
    places = {tuple(p) for p in np.round(mesh.points[list(one)], 6)}
    shared = [p for p in np.round(mesh.points[list(other)], 6) if tuple(p) in places]
    assert len(shared) == pytest.approx(made.frame.width / 10 + 1, abs=2)


def test_what_slides_on_a_rigid_label_is_marked(phantom):
    made, hidden = phantom
    indenter, floor = made.rigid_labels
    mesh = mesh_segmentation(hidden, 10.0, rigid_labels=[indenter, floor], sliding_labels=[floor])
    y = made.frame.to_body(mesh.points)[:, 1]
    assert set(mesh.reaction_nodes[y < 1]) == {1}
    assert set(mesh.reaction_nodes[y > made.frame.height - 1]) == {2}


@pytest.mark.slow
def test_each_side_of_a_slip_is_measured_by_itself(phantom):
    pytest.importorskip("itk")
    made, hidden = phantom
    told = study(made, hidden, slip=[(PAD, TISSUE)], backward=False)
    mesh = pipeline.make_mesh(told)
    true = truth(made, mesh)
    near = np.abs(made.frame.to_body(mesh.points)[:, 1] - 0.25 * made.frame.height) < 0.5
    missed = []
    for one in (told, study(made, hidden, backward=False)):
        found = pipeline.measure(one, mesh.points, mesh.cells, reaction_nodes=mesh.reaction_nodes)
        error = (found.displacements - true)[0, near, 0] / found.report["pixel"]
        missed.append(np.sqrt((error**2).mean()))
    assert missed[0] < 0.3
    assert missed[0] < 0.6 * missed[1]
