"""Frames of ultrasound in MATLAB files."""

import numpy as np
import pytest
from elastoidentify.cli import main
from elastoidentify.errors import InputError
from elastoidentify.imaging.io import read_image
from scipy.io import savemat

RF = np.random.default_rng(0).standard_normal((120, 40))


def saved(tmp_path, **arrays):
    path = tmp_path / "frame.mat"
    savemat(path, arrays)
    return path


def test_rows_are_samples_and_columns_lines_and_the_missing_size_is_said(tmp_path):
    image = read_image(saved(tmp_path, rf=RF, fs=40e6, name="phantom"))
    assert tuple(image.size) == (40, 120, 1)
    assert np.array_equal(image.array[0], RF)
    assert "has no voxel size" in image.notes[0]


def test_convert_gives_it_a_voxel_size(tmp_path, capsys):
    source, target = saved(tmp_path, rf=RF), tmp_path / "rest.nrrd"
    assert main(["convert", str(source), str(target), "--spacing", "0.3", "0.02"]) == 0
    image = read_image(target)
    assert np.allclose(image.spacing[:2], [0.3, 0.02])
    assert np.allclose(image.array[0], RF)
    assert main(["convert", str(source), str(target), "--spacing", "0.3", "-1"]) == 2
    assert "give two or three lengths above 0" in capsys.readouterr().err


def test_a_frame_of_a_film_and_an_array_of_several_are_chosen(tmp_path):
    film = np.stack([RF, 2 * RF, 3 * RF], axis=2)
    path = saved(tmp_path, rf=film, envelope=np.abs(RF))
    assert np.array_equal(read_image(path, series="rf", frame=2).array[0], 2 * RF)
    for options, message in (
        ({}, r"several arrays, envelope \(120 × 40\), rf \(120 × 40 × 3\); choose one"),
        ({"series": "b"}, "has no array 'b'"),
        ({"series": "rf"}, "a film of 3 frames"),
        ({"series": "rf", "frame": 4}, "has frames 1 to 3"),
        ({"series": "envelope", "frame": 1}, "is no film"),
    ):
        with pytest.raises(InputError, match=message):
            read_image(path, **options)


def test_what_is_no_frame_is_refused_in_one_line(tmp_path):
    with pytest.raises(InputError, match="is complex"):
        read_image(saved(tmp_path, iq=RF + 1j * RF))
    with pytest.raises(InputError, match="no array of samples by lines"):
        read_image(saved(tmp_path, fs=40e6))
    path = tmp_path / "new.mat"
    path.write_bytes(b"MATLAB 7.3 MAT-file, Platform".ljust(600, b"\0"))
    with pytest.raises(InputError, match=r"is of MATLAB 7\.3: save it with"):
        read_image(path)


@pytest.mark.parametrize("kept", [20, 130, 200, 2000])
def test_a_cut_file_is_refused(tmp_path, kept):
    path = saved(tmp_path, rf=RF)
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(InputError, match=r"frame\.mat"):
        read_image(path)
