"""Finished registrations are read, not made again, if all that went in is the same."""

import numpy as np
import pytest
from elastoidentify.imaging.image import Image
from elastoidentify.imaging.registration import register
from elastoidentify.imaging.registration.cache import RegistrationCache

POINTS = np.array([[8.0, 8.0, 0.0], [40.0, 8.0, 0.0], [40.0, 40.0, 0.0], [8.0, 40.0, 0.0]])
CELLS = np.array([[0, 1, 2], [0, 2, 3]])
SHIFT = np.array([0.4, -0.3])


class Engine:
    """An elastix that knows the answer, counts its calls, and dies when it is told to."""

    def __init__(self, dies_at=None):
        self.calls, self.dies_at = 0, dies_at

    def register(self, fixed, moving, spacing, maps, points, *, mask=None, warp=True, progress):
        self.calls += 1
        if self.calls == self.dies_at:
            raise KeyboardInterrupt
        return points + SHIFT * spacing, fixed.copy() if warp else None


@pytest.fixture(scope="module")
def images():
    random = np.random.default_rng(0)
    return [Image(100 + 20 * random.standard_normal((1, 48, 48))) for _ in range(3)]


def registered(images, engine, folder, **options):
    rest, *pushed = images
    return register(
        rest, pushed, POINTS, CELLS, refine=False, elastix=engine, cache=folder, **options
    )


def test_a_run_that_was_killed_goes_on_where_it_was(images, tmp_path):
    dying, going_on, whole = Engine(dies_at=3), Engine(), Engine()
    with pytest.raises(KeyboardInterrupt):
        registered(images, dying, tmp_path)
    assert len(list(tmp_path.iterdir())) == 2
    resumed = registered(images, going_on, tmp_path)
    fresh = registered(images, whole, None)
    assert (going_on.calls, whole.calls) == (2, 4)
    np.testing.assert_array_equal(resumed.displacements, fresh.displacements)
    np.testing.assert_array_equal(resumed.information, fresh.information)
    again = Engine()
    registered(images, again, tmp_path)
    assert again.calls == 0


@pytest.mark.parametrize("changed", ["image", "points", "parameters", "damaged"])
def test_whatever_is_not_the_same_is_registered_again(images, tmp_path, changed, monkeypatch):
    registered(images, Engine(), tmp_path)
    engine, options = Engine(), {}
    others, points = list(images), POINTS
    if changed == "image":
        others[1] = images[1].with_array(images[1].array + 1e-3)
    elif changed == "points":
        points = POINTS + 0.25
    elif changed == "parameters":
        options["parameters"] = "affine"
    else:
        for file in tmp_path.iterdir():
            file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    rest, *pushed = others
    register(rest, pushed, points, CELLS, refine=False, elastix=engine, cache=tmp_path, **options)
    assert engine.calls == (2 if changed == "image" else 4)


def test_an_answer_is_kept_whole_or_not_at_all(tmp_path):
    cache = RegistrationCache(tmp_path / "new" / "folder")
    assert cache.read("a" * 64) is None
    cache.write("a" * 64, (POINTS, None))
    mapped, warped = cache.read("a" * 64)
    np.testing.assert_array_equal(mapped, POINTS)
    assert warped is None
    assert [file.suffix for file in (tmp_path / "new" / "folder").iterdir()] == [".npz"]
