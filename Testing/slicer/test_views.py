"""What the slice view and the 3-D view show, drawn by Slicer's own displayable managers."""

import numpy as np
import pytest

slicer = pytest.importorskip("slicer")

from ElastoIdentifyLib import images, sample  # noqa: E402
from ElastoIdentifyLib.outputs import cube_helix  # noqa: E402
from standins.views import slice_view, space_view  # noqa: E402

from ElastoIdentify import ElastoIdentifyLogic  # noqa: E402


def screen_axes(volume):
    """Right, up and towards the viewer, for the plane of a volume of one slice."""
    axes = images.ijk_to_world(volume)[:3, :3]
    axes = axes / np.linalg.norm(axes, axis=0)
    return np.column_stack([axes[:, 0], -axes[:, 1], axes[:, 2]])


def share_of(pixels, colour, tolerance=6):
    return float((np.abs(pixels.astype(int) - colour).max(axis=-1) <= tolerance).mean())


@pytest.fixture
def pictures():
    """Pictures before and after the map is there, and the result."""
    inputs, _ = sample.add_exact_push()
    axes = screen_axes(inputs["restVolume"])
    with slice_view(inputs["restVolume"], axes) as flat, space_view() as space:
        before = flat.array().copy(), space.array().copy()
        result = ElastoIdentifyLogic().process(**inputs)
        space.look(axes @ [0.2, -0.3, 1.0], axes[:, 1])
        yield before, (flat.array().copy(), space.array().copy()), result


def test_the_map_is_seen_over_the_image_in_the_slice_view(pictures):
    (before, _), (after, _), _ = pictures
    assert before.max() > 150
    assert np.ptp(before, axis=-1).max() == 0  # an image without colour
    coloured = np.ptp(after.astype(int), axis=-1) > 8
    # pad and tissue cover 28 × 24 of 40 × 40 voxels, and the view shows a margin
    assert 0.25 < coloured.mean() < 0.55


def test_both_stiffnesses_have_the_ends_of_the_colour_table_in_3d(pictures):
    _, (_, after), _ = pictures
    low, high = (cube_helix(np.array([b]))[0] * 255 for b in (0.15, 0.85))
    assert share_of(after, low) > 0.03
    assert share_of(after, high) > 0.08


def test_the_legend_is_drawn_with_its_title(pictures):
    _, (flat, _), _ = pictures
    corner = flat[:, -130:]
    assert share_of(corner, np.array([255, 255, 255]), 2) > 0.002  # letters
    colours = {tuple(pixel) for pixel in corner[250:500, -40:].reshape(-1, 3)}
    assert len(colours) > 60  # the bar


def test_the_pictures_of_the_documentation_can_be_made(tmp_path):
    from standins.pictures import make_pictures

    made = make_pictures(tmp_path, small=True)
    assert all(path.stat().st_size > 2000 for path in made)
