"""Every option of the table arrives: from the filter in the library, from ParaView's XML in it."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest
from elastoidentify.filters import (
    ElastixNodalDisplacement,
    LameIdentification,
    PushingPhantom,
    SegmentationToMesh,
)
from elastoidentify.imaging.image import Image
from elastoidentify.options import Rows
from elastoidentify.paraview import box, panel
from elastoidentify.study import (
    IdentificationOptions,
    MeshOptions,
    RegistrationOptions,
    ReportOptions,
)
from elastoidentify.vtk_io.arrays import KNOWN
from elastoidentify.vtk_io.convert import image_to_vtk
from option_samples import needing, option_id, sample, scalar_options

FILTERS = {
    MeshOptions: SegmentationToMesh,
    RegistrationOptions: ElastixNodalDisplacement,
    IdentificationOptions: LameIdentification,
    ReportOptions: LameIdentification,
}
STEPS = {
    MeshOptions: "make_mesh",
    RegistrationOptions: "measure",
    IdentificationOptions: "identify_mesh",
    ReportOptions: "identify_mesh",
}
LIBRARY = {
    MeshOptions: "elastoidentify.pipeline.mesh_segmentation",
    RegistrationOptions: "elastoidentify.imaging.registration.register",
    IdentificationOptions: "elastoidentify.pipeline.identify",
}


class Arrived(Exception):
    """What a function was called with."""

    def __init__(self, arguments, keywords):
        super().__init__(arguments, keywords)
        self.arguments, self.keywords = arguments, keywords


def stop(*arguments, **keywords):
    raise Arrived(arguments, keywords)


def connected(table):
    """A filter of the table with all that it needs to get to its step."""
    images = [image_to_vtk(Image(np.arange(60.0).reshape(3, 4, 5) + n)) for n in range(3)]
    phantom = PushingPhantom(resolution=2)
    made = FILTERS[table]()
    if table is MeshOptions:
        made.SetInputData(images[0])
    elif table is RegistrationOptions:
        made.SetMesh(phantom)
        made.SetRestImage(images[0])
        made.AddPushedImage(images[1])
    else:
        mesh = phantom.update().output
        for name in KNOWN:  # so that labels which it does not have are seen by the library alone
            mesh.GetCellData().RemoveArray(name)
        made.SetInputData(mesh)
    return made


def set_as_vtk_does(made, option, value):
    """Call the methods that the XML of ParaView names."""
    if isinstance(option, Rows):
        for row in value:
            getattr(made, f"Add{option.row}")(*(row if isinstance(row, tuple) else (row,)))
    else:
        getattr(made, f"Set{option.title}")(value)


@pytest.mark.parametrize(("table", "option"), scalar_options(), ids=option_id)
def test_every_option_of_a_filter_arrives_in_its_step(table, option, monkeypatch):
    monkeypatch.setattr(f"elastoidentify.pipeline.{STEPS[table]}", stop)
    made = connected(table)
    set_as_vtk_does(made, option, sample(option))
    with pytest.raises(Arrived) as seen:
        made.Update()
    assert getattr(seen.value.arguments[0], option.name) == sample(option)


@pytest.mark.parametrize(
    ("table", "option"), [one for one in scalar_options() if one[1].keyword], ids=option_id
)
def test_every_option_of_a_filter_arrives_in_the_library(table, option, monkeypatch):
    monkeypatch.setattr(LIBRARY[table], stop)
    made = connected(table)
    set_as_vtk_does(made, option, sample(option))
    if option.needs:
        setattr(made, *option.needs)
    with pytest.raises(Arrived) as seen:
        made.Update()
    assert seen.value.keywords[option.keyword] == sample(option)


@pytest.mark.parametrize("option", needing(), ids=option_id)
def test_an_option_that_is_not_used_is_a_warning(option):
    found = LameIdentification(method="global")
    found.SetInputData(PushingPhantom(resolution=2)())
    set_as_vtk_does(found, option, sample(option))
    with pytest.warns(UserWarning, match=f"{option.name} says something only with"):
        found.Update()


def test_the_images_of_all_ports_arrive(monkeypatch):
    monkeypatch.setattr("elastoidentify.pipeline.measure", stop)
    made = connected(RegistrationOptions)
    mask = np.ones((3, 4, 5), np.uint8)
    made.SetMask(image_to_vtk(Image(mask)))
    with pytest.raises(Arrived) as seen:
        made.Update()
    chosen = seen.value.arguments[0]
    first = [image.array.flat[0] for image in (chosen.rest, *chosen.pushed, chosen.mask)]
    assert first == [0, 1, 1]


@pytest.mark.parametrize("kind", ["reaction", "sliding"])
def test_the_box_in_paraviews_view_is_one_more_of_its_kind(kind, monkeypatch):
    monkeypatch.setattr("elastoidentify.pipeline.make_mesh", stop)
    first = (0.0, 9.0, 0.0, 9.0, 0.0, 9.0)
    made = box.SegmentationToTriangleMesh(
        reaction_boxes=[first], sliding_boxes=[first], box_in_view=kind
    )
    made.SetInputData(image_to_vtk(Image(np.arange(60).reshape(3, 4, 5))))
    made.SetBoxCorner(1, 2, 3)
    made.SetBoxSize(10, -5, 0)  # a face drawn through the opposite one
    with pytest.raises(Arrived) as seen:
        made.Update()
    found = seen.value.arguments[0]
    boxes = {"reaction": found.reaction_boxes, "sliding": found.sliding_boxes}
    assert boxes.pop(kind) == (first, (1.0, 11.0, -3.0, 2.0, 3.0, 3.0))
    assert list(boxes.values()) == [(first,)]


@pytest.mark.parametrize(("table", "option"), scalar_options(), ids=option_id)
def test_paraview_has_a_property_for_every_option(table, option):
    form = ET.fromstring(f"<proxy>{panel.settings(FILTERS[table])}</proxy>")
    (found,) = [element for element in form if element.get("name") == option.title]
    assert callable(getattr(FILTERS[table], found.get("command")))
    assert (found.get("panel_visibility") == "advanced") == option.advanced
    words = " ".join(option.__doc__.split())
    assert found.findtext("Documentation") == words
    assert ("default_values" in found.attrib) != isinstance(option, Rows)  # nothing is prefilled
