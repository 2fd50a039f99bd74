"""What the library says comes in the user's language, and Slicer's tools find all of it."""

import ast

import pytest

slicer = pytest.importorskip("slicer")

from elastoidentify import InputError  # noqa: E402
from elastoidentify.imaging.registration.registration import _trial_warnings  # noqa: E402
from elastoidentify.inverse.verdict import judge  # noqa: E402
from elastoidentify.study import Study  # noqa: E402
from ElastoIdentifyLib import messages, sample, translation  # noqa: E402
from make_messages import LEFT_OUT, PACKAGE, ROOMS, is_sentence, module, template  # noqa: E402

from ElastoIdentify import ElastoIdentifyLogic  # noqa: E402

pytestmark = pytest.mark.usefixtures("warm")


@pytest.fixture
def marked(monkeypatch):
    """A language in which every sentence stands between marks."""
    monkeypatch.setattr(messages, "tr", "«{}»".format)
    return translation.translated


def test_the_table_is_that_of_the_librarys_source():
    again = "python Testing/slicer/make_messages.py > ElastoIdentify/ElastoIdentifyLib/messages.py"
    with open(messages.__file__, encoding="utf-8") as file:
        assert file.read() == module(), f"the library has other sentences now: {again}"


def test_every_refusal_of_the_library_is_in_the_table():
    """But one that is joined of warnings, and one that a helper ends."""
    missing = []
    for room in ROOMS:
        for path in sorted((PACKAGE / room).rglob("*.py")) or [PACKAGE / room]:
            if path.relative_to(PACKAGE).as_posix().startswith(LEFT_OUT):
                continue
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "InputError":
                    text = template(node.args[0])
                    if text is None or not is_sentence(text):
                        missing.append(ast.unparse(node.args[0]))
    assert len(missing) == 2, missing


def test_every_sentence_is_found_with_its_numbers(marked):
    for text in messages.TEMPLATES:
        said = text.format(*(f"{n}.{n}" for n in range(10)))
        assert marked(said) == f"«{said}»"


def test_a_translation_may_put_what_is_filled_in_into_another_order(monkeypatch):
    words = {
        "known label {0} does not occur in the mesh, its labels are {1}": "{1} hat kein {0}",
    }
    monkeypatch.setattr(messages, "tr", lambda text: words.get(text, text))
    said = translation.translated("known label 7 does not occur in the mesh, its labels are 1, 2")
    assert said == "1, 2 hat kein 7"
    assert translation.translated("what nobody wrote") == "what nobody wrote"


def test_what_is_put_together_is_translated_part_by_part(marked):
    report = {"method": "global", "grouping": "cell", "large_push": True, "cut_nodes": 3}
    report |= {"cells": {"known": 1, "not_determined": 4, "out_of_range": 0, "identified": 5}}
    report |= {"lost_trials": [], "noise_given": False}
    assert marked(judge(report, False, False)["sentence"]) == (
        "««Trust this map with care»: 44% of the unknown cells are not determined»; "
        "«the push is too large for small-strain kinematics: take neo-hookean»; "
        "«the mesh was cut»."
    )
    figures = {"similarity_before": 0.5, "similarity_after": 0.1, "disagreement_median": 3.0}
    figures |= dict.fromkeys(("nodes_disagreeing", "nodes_leaving", "folded_cells"), 0)
    figures |= {"nodes_without_texture": 0, "largest_displacement_pixels": 9}
    (lost,) = _trial_warnings(1, figures)
    assert marked(lost).count("«") == 4


def test_what_the_library_refuses_is_shown_in_the_users_language(marked):
    expected = pytest.raises(InputError, match=r"^«Study.noise must be .*, not -1»$")
    with expected, translation.refused_in_users_language():
        Study(noise=-1)


def test_report_and_panel_are_in_the_users_language(marked):
    inputs, _ = sample.add_exact_push()
    inputs["options"] |= {"unknowns": "lambda-mu"}
    report = ElastoIdentifyLogic.report(ElastoIdentifyLogic().process(**inputs))
    assert "«Trust this map" in report
    assert "«poisson_ratio says something only with unknowns" in report
