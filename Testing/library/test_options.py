"""The table of options: what is declared, and that every option arrives where it is used."""

import inspect
import re
from pathlib import Path

import numpy as np
import pytest
from elastoidentify import InputError, pipeline
from elastoidentify.cli import main
from elastoidentify.imaging.image import Image
from elastoidentify.inverse.identify import identify
from elastoidentify.options import Choice, File, Flag, Number, Picture, Rows, unused
from elastoidentify.results import Status
from elastoidentify.study import (
    STEPS,
    IdentificationOptions,
    MeshOptions,
    ReadOptions,
    RegistrationOptions,
    Study,
)
from option_samples import needing, option_id, pictures, sample, scalar_options

OPTIONS_PAGE = Path(__file__).resolve().parents[2] / "docs" / "options.md"


class Arrived(Exception):
    """What a function was called with."""

    def __init__(self, arguments, keywords):
        self.arguments, self.keywords = arguments, keywords


def stop(*arguments, **keywords):
    raise Arrived(arguments, keywords)


def an_image():
    return Image(np.arange(60).reshape(3, 4, 5))


# ---- the table


def test_no_two_steps_use_one_name_for_two_things():
    found = {}
    for table in STEPS.values():
        for name, option in table.options().items():
            same = found.setdefault(name, option)
            assert type(same) is type(option) and same.flags == option.flags, name
    shared = [name for name in found if sum(name in t.options() for t in STEPS.values()) > 1]
    assert shared == ["slip"]  # the mesh is split, and then no shear is passed on


@pytest.mark.parametrize("name", Study.options())
def test_every_option_has_a_sentence_a_group_and_an_allowed_default(name):
    option = Study.options()[name]
    assert len(option.__doc__) > 15
    assert option.__doc__.endswith(".")
    assert option.group
    assert option.checked(option.default) == option.default


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("edge_length", np.nan),
        ("edge_length", -1.0),
        ("noise", np.inf),
        ("poisson_ratio", 0.5),
        ("poisson_ratio", -1.0),
        ("refine", 17),
        ("method", "gobal"),
        ("known_materials", {1: (np.nan, 0.4)}),
        ("known_materials", {1: (0.0, 0.4)}),
        ("known_materials", {1: (5000.0, 0.5)}),
        ("known_materials", [(1, 5000.0, 0.4), (1, 3000.0, 0.4)]),
        ("known_materials", [(1.5, 5000.0, 0.4)]),
        ("reaction_boxes", [(0, 1, 2)]),
        ("reaction_boxes", [(0, 1, 2, np.nan)]),
        ("slice_index", 1.5),
    ],
)
def test_absurd_values_are_refused_and_the_option_is_named(name, value):
    with pytest.raises(InputError, match=f"{name}|known label"):
        Study(**{name: value})


def test_images_are_replaced_without_a_look_at_their_voxels():
    study = Study(rest=an_image(), pushed=[an_image()])
    study.rest, study.pushed = an_image(), [an_image(), an_image()]
    assert len(study.pushed) == 2


def test_a_misspelt_option_is_refused_and_the_near_one_is_named():
    with pytest.raises(InputError, match="'kinematics'"):
        Study(kinematic="neo-hookean")


def test_what_identify_takes_by_default_is_the_tables_default():
    parameters = inspect.signature(identify).parameters
    for option in IdentificationOptions.options().values():
        if option.keyword:
            default = parameters[option.keyword].default
            assert default == option.argument(IdentificationOptions()), option.name


@pytest.mark.parametrize("option", needing(), ids=option_id)
def test_what_is_given_and_not_used_is_said_and_what_a_form_begins_with_is_not(option):
    said = f"{option.name} says something only with {option.needs[0]} {option.needs[1]}"
    (sentence,) = unused(Study(**{option.name: sample(option)}), IdentificationOptions)
    assert sentence.startswith(said)
    needed = {option.needs[0]: option.needs[1]}
    assert unused(Study(**{option.name: sample(option)}, **needed), IdentificationOptions) == []
    assert unused(Study(**{option.name: option.form_start}), IdentificationOptions) == []


# ---- from the table to the library


FUNCTIONS = {
    MeshOptions: ("elastoidentify.pipeline.mesh_segmentation", pipeline.make_mesh, ()),
    RegistrationOptions: (
        "elastoidentify.imaging.registration.register",
        pipeline.measure,
        (np.zeros((4, 3)), np.array([[0, 1, 2, 3]])),
    ),
    IdentificationOptions: (
        "elastoidentify.pipeline.identify",
        pipeline.identify_mesh,
        (np.zeros((3, 3)), [], np.zeros((1, 3, 3))),
    ),
}


@pytest.mark.parametrize(
    ("table", "option"), [one for one in scalar_options() if one[1].keyword], ids=option_id
)
def test_every_option_arrives_in_the_library(table, option, monkeypatch):
    function, step, rest = FUNCTIONS[table]
    monkeypatch.setattr(function, stop)
    study = Study(segmentation=an_image(), rest=an_image(), pushed=[an_image()])
    setattr(study, option.name, sample(option))
    if option.needs:
        setattr(study, *option.needs)
    with pytest.raises(Arrived) as seen:
        step(study, *rest)
    assert seen.value.keywords[option.keyword] == sample(option)


def test_the_options_without_a_keyword_arrive_too(monkeypatch):
    monkeypatch.setattr("elastoidentify.pipeline.mesh_segmentation", stop)
    image = an_image()
    for axis, index, values in (("j", 2, image.array[:, 2]), ("k", -1, image.array[1])):
        with pytest.raises(Arrived) as seen:
            pipeline.make_mesh(Study(segmentation=image, slice_axis=axis, slice_index=index))
        np.testing.assert_array_equal(seen.value.arguments[0].array.squeeze(), values)
    monkeypatch.setattr("elastoidentify.pipeline.identify", stop)
    with pytest.raises(Arrived) as seen:
        pipeline.identify_mesh(
            Study(known_materials={3: (7.0, 0.2)}), np.zeros((3, 3)), [], np.zeros((1, 3, 3))
        )
    assert seen.value.arguments[3] == {3: (7.0, 0.2)}


def test_unit_and_length_unit_arrive_in_the_table_of_labels(square_result):
    row = square_result(unit="kPa", length_unit="cm").statistics[0]
    assert (row["unit"], row["size unit"]) == ("kPa", "cm²")


@pytest.fixture
def square_result():
    """Identify a square under exact displacements, with options."""
    from elastoidentify.examples.paper import example, pushed

    square = example()

    def made(**options):
        return pipeline.identify_mesh(
            Study(known_materials={2: (5000.0, 0.43)}, kinematics="neo-hookean", **options),
            square.points,
            square.cells,
            pushed(square, 0, "neo-hookean"),
            labels=square.labels,
            reaction_nodes=square.floor | square.top,
        )

    return made


def test_given_cells_have_the_status_and_no_error(square_result):
    result = square_result()
    given = result.status == Status.KNOWN
    assert given.any()
    assert not result.young_std[given].any()
    assert [row["given"] for row in result.statistics] == [False, True]


# ---- from the command line to the table


def words(option):
    """Return an option's words on the command line, with a value that is not the default."""
    value, flag = sample(option), option.flags[0]
    if isinstance(option, Flag):
        return [flag]
    if option.name == "known_materials":
        return [w for label, e, nu in value for w in (flag, f"{label}:E={e:g},nu={nu:g}")]
    if isinstance(option, Rows):
        rows = [row if isinstance(row, tuple) else (row,) for row in value]
        between = ":" if option.name == "slip" else ","
        return [w for row in rows for w in (flag, between.join(f"{x:g}" for x in row))]
    return [flag, str(value)]


@pytest.fixture
def command(tmp_path, monkeypatch):
    """Run ``elastoidentify run`` up to the pipeline and return the study that arrives there."""
    sitk = pytest.importorskip("SimpleITK")
    pytest.importorskip("vtkmodules")
    for name in ("seg", "rest", "push", "mask"):
        image = sitk.GetImageFromArray(np.full((1, 4, 5), len(name) + ord(name[0]), np.int16))
        sitk.WriteImage(image, str(tmp_path / f"{name}.nrrd"))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("elastoidentify.pipeline.run", stop)
    monkeypatch.setattr("elastoidentify.workers.elastix_client.find_interpreter", lambda: "python")
    monkeypatch.setenv("ELASTOIDENTIFY_TRACEBACK", "1")

    def run(*more):
        files = ["--segmentation", "seg.nrrd", "--rest", "rest.nrrd", "--pushed", "push.nrrd"]
        with pytest.raises(Arrived) as seen:
            main(["run", *files, "-o", "out.vtu", *more])
        return seen.value

    return run


@pytest.mark.parametrize(("table", "option"), scalar_options(), ids=option_id)
def test_every_option_arrives_from_the_command_line(table, option, command):
    with_it = [] if not option.needs else ["--" + option.needs[0], option.needs[1]]
    (study,) = command(*words(option), *with_it).arguments
    assert getattr(study, option.name) == sample(option)
    others = {k: v for k, v in Study.options().items() if not isinstance(v, Picture)}
    for name in others.keys() - {option.name, *(option.needs or ())}:
        assert getattr(study, name) == others[name].default


def test_every_image_arrives_from_the_command_line(command):
    arrived = command("--mask", "mask.nrrd", "--pushed", "mask.nrrd")
    (study,) = arrived.arguments
    assert {option.name for _, option in pictures()} == {"segmentation", "rest", "pushed", "mask"}
    assert study.segmentation.array[0, 0, 0] == 3 + ord("s")
    assert study.rest.array[0, 0, 0] == 4 + ord("r")
    assert [image.array[0, 0, 0] for image in study.pushed] == [4 + ord("p"), 4 + ord("m")]
    assert study.mask.array[0, 0, 0] == 4 + ord("m")
    prints = arrived.keywords["inputs"]
    assert [one["name"] for one in prints["pushed"]] == ["push.nrrd", "mask.nrrd"]
    assert all(re.fullmatch("[0-9a-f]{64}", one["sha256"]) for one in prints["pushed"])


@pytest.mark.parametrize("name", ReadOptions.options())
def test_every_option_of_reading_arrives(name, command, monkeypatch):
    option = ReadOptions.options()[name]
    value = "2" if name == "series" else 3
    monkeypatch.setattr("elastoidentify.imaging.io.read_image", stop)
    (seen,) = [command(*option.flags, str(value))]
    assert seen.keywords[name] == value


@pytest.mark.parametrize(
    "said",
    [
        ["--known", "1:E=5000,nu=0.4", "--known", "1:E=3000,nu=0.4"],
        ["--known", "1:E=5,nu=0.4,E=6"],
        ["--noise", "nan"],
        ["--noise", "-1"],
        ["--edge-length", "inf"],
        ["--poisson", "0.5"],
        ["--poisson", "0.45"],
        ["--refine", "-4"],
        ["--slice", "x:1"],
    ],
)
def test_absurd_or_contradictory_words_are_usage_errors(said, capsys):
    files = ["--segmentation", "s", "--rest", "r", "--pushed", "p", "-o", "out.vtu"]
    assert main(["run", *files, *said]) == 2
    err = capsys.readouterr().err.strip()
    assert len(err.splitlines()) == 1


# ---- the page


def test_the_page_of_options_is_that_of_the_table():
    from elastoidentify.report.options_page import options_page

    assert OPTIONS_PAGE.read_text(encoding="utf-8") == options_page()


def test_every_kind_of_option_is_used():
    used = {type(option) for option in Study.options().values()}
    assert {Number, Choice, Flag, Rows, File, Picture} <= used
