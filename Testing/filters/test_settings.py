"""Settings of filters: keywords, properties and Set/Get are one thing, and refuse what is wrong."""

import pytest
from elastoidentify import InputError
from elastoidentify.filters import (
    ElastixNodalDisplacement,
    LameIdentification,
    PushingPhantom,
    SegmentationToTriangleMesh,
)

ALL = [
    ElastixNodalDisplacement,
    LameIdentification,
    PushingPhantom,
    SegmentationToTriangleMesh,
]


def test_keyword_property_and_setter_are_the_same_setting():
    by_keyword = LameIdentification(method="global")
    by_property, by_setter = LameIdentification(), LameIdentification()
    by_property.method = "global"
    by_setter.SetMethod("global")
    assert by_keyword.GetMethod() == by_property.GetMethod() == by_setter.method == "global"


@pytest.mark.parametrize("filter_class", ALL)
def test_every_option_has_setter_getter_documentation_and_keeps_its_default(filter_class):
    filter = filter_class()
    for name, option in filter_class.options().items():
        setter = getattr(filter, f"Set{option.title}")
        getter = getattr(filter, f"Get{option.title}")
        assert len(option.__doc__) > 15 and setter.__doc__ == option.__doc__
        setter(getter())
        assert getattr(filter, name) == option.default


@pytest.mark.parametrize("filter_class", ALL)
def test_unknown_names_are_refused_and_the_near_one_is_named(filter_class):
    name = next(iter(filter_class.options()))
    with pytest.raises(AttributeError, match=f"did you mean '{name}'"):
        setattr(filter_class(), name + "x", 1)
    with pytest.raises(TypeError, match=f"did you mean '{name}'"):
        filter_class(**{name + "x": 1})


@pytest.mark.parametrize(
    ("filter_class", "name", "value"),
    [
        (LameIdentification, "method", "gobal"),
        (LameIdentification, "noise", -1.0),
        (LameIdentification, "noise", "loud"),
        (LameIdentification, "noise", float("nan")),
        (LameIdentification, "refine", 1.5),
        (LameIdentification, "known_materials", [(1.5, 5000.0, 0.43)]),
        (LameIdentification, "known_materials", [(1, 5000.0)]),
        (SegmentationToTriangleMesh, "edge_length", float("inf")),
        (SegmentationToTriangleMesh, "reaction_boxes", [(0, 1, 2)]),
        (PushingPhantom, "inclusion_center", (0.5, 0.5)),
    ],
)
def test_wrong_values_are_refused_by_name_and_leave_the_setting_alone(filter_class, name, value):
    filter = filter_class()
    before = getattr(filter, name)
    with pytest.raises(InputError, match=name):
        setattr(filter, name, value)
    assert getattr(filter, name) == before


def test_known_materials_come_one_by_one_as_rows_or_as_a_mapping():
    one_by_one = LameIdentification()
    one_by_one.AddKnownMaterial(1, 5000.0, 0.43)
    one_by_one.AddKnownMaterial(4, 900.0, 0.3)
    rows = ((1, 5000.0, 0.43), (4, 900.0, 0.3))
    assert one_by_one.known_materials == rows
    assert LameIdentification(known_materials=rows).known_materials == rows
    assert (
        LameIdentification(known_materials={1: (5e3, 0.43), 4: (900, 0.3)}).known_materials == rows
    )
    one_by_one.ClearKnownMaterials()
    assert one_by_one.known_materials == ()


def test_reaction_boxes_take_planes_and_volumes_and_rigid_labels_are_whole():
    mesher = SegmentationToTriangleMesh()
    mesher.AddReactionBox(0, 1, 2, 3)
    mesher.AddReactionBox((0, 1, 2, 3, 4, 5))
    mesher.AddRigidLabel(3)
    assert mesher.reaction_boxes == ((0, 1, 2, 3), (0, 1, 2, 3, 4, 5))
    assert mesher.rigid_labels == (3,)
    mesher.BorderReactionsOff()
    assert mesher.GetBorderReactions() is False


def test_only_a_change_modifies():
    filter = LameIdentification(method="global", known_materials={1: (5000.0, 0.43)})
    before = filter.GetMTime()
    filter.method = "global"
    filter.known_materials = {1: (5000.0, 0.43)}
    filter.poisson_ratio = None
    assert filter.GetMTime() == before
    filter.method = "sequential"
    assert filter.GetMTime() > before
