"""The ParaView plugin of ElastoIdentify: load this file, or start ``elastoidentify paraview``.

Every class is a filter of :mod:`elastoidentify.filters` with a form for ParaView. Filters ▸
ElastoIdentify has *Segmentation To Triangle Mesh*, *Elastix Nodal Displacement* and *Lame
Identification*, Sources ▸ ElastoIdentify has *Pushing Phantom*; in pvpython they are
``SegmentationToTriangleMesh(...)`` and so on.
"""

import inspect
import sys
from pathlib import Path

# ParaView 5.11.0 needs this under Python 3.11; where it is too late, see docs/paraview.md.
if not hasattr(inspect, "getargspec"):
    inspect.getargspec = inspect.getfullargspec

try:
    import elastoidentify
except ImportError:  # loaded by its path, the package not installed for ParaView's Python
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
    import elastoidentify

from paraview.util.vtkAlgorithm import smhint, smproperty, smproxy

from elastoidentify import filters
from elastoidentify.filters.reading import SUFFIXES
from elastoidentify.paraview import box, display, failures, legends, panel, stopping, writers
from elastoidentify.vtk_io.arrays import label_table

paraview_plugin_name = "ElastoIdentify"
paraview_plugin_version = elastoidentify.__version__
failures.install()
display.set_defaults()
stopping.install()

_ICON = Path(elastoidentify.__file__).parent / "paraview" / "icons" / "ElastoIdentify.png"
in_menu = smhint.xml(f'<ShowInMenu category="ElastoIdentify" icon="{_ICON}"/>')


def form(*parts: str):
    """Return the class decorator that puts the XML of all `parts` into the proxy.

    ParaView goes on after an exception of a setter, so what is refused fails the next run instead.
    """

    def decorate(filter_class):
        filter_class.refusals_wait = True
        return smproperty.xml("".join(parts))(filter_class)

    return decorate


@smproxy.source(name="PushingPhantom", label="Pushing Phantom", support_reload=False)
@in_menu
@form(
    panel.documentation(filters.PushingPhantom),
    panel.settings(filters.PushingPhantom),
    panel.last_error(),
)
class PushingPhantom(filters.PushingPhantom):
    __doc__ = filters.PushingPhantom.__doc__


_reader = (
    panel.documentation(filters.ImageFile),
    panel.settings(
        filters.ImageFile, {"file_names": panel.file_names(filters.ImageFile.file_names)}
    ),
    panel.last_error(),
)


@smproxy.source(name="ElastoIdentifyImage", label="ElastoIdentify Image", support_reload=False)
@smhint.xml(panel.opens("Images with orientation", extensions=SUFFIXES))
@form(*_reader)
class ElastoIdentifyImage(filters.ImageFile):
    __doc__ = filters.ImageFile.__doc__


@smproxy.source(
    name="ElastoIdentifyDicomFolder", label="ElastoIdentify Dicom Folder", support_reload=False
)
@smhint.xml(panel.opens("DICOM folder", folders=True))
@form(*_reader)
class ElastoIdentifyDicomFolder(filters.ImageFile):  # a reader of folders opens nothing else
    __doc__ = filters.ImageFile.__doc__


@smproxy.filter(
    name="SegmentationToTriangleMesh", label="Segmentation To Triangle Mesh", support_reload=False
)
@in_menu
@form(
    panel.documentation(box.SegmentationToTriangleMesh),
    panel.inputs(
        box.SegmentationToTriangleMesh,
        {
            "segmentation": '<InputArrayDomain name="labels" attribute_type="point" '
            'number_of_components="1"/>'
        },
    ),
    panel.settings(
        box.SegmentationToTriangleMesh,
        {
            "label_array": panel.array_name(
                box.SegmentationToTriangleMesh.label_array, "Input", "labels"
            ),
            "rigid_labels": panel.array_selection(
                "RigidLabels",
                "GetRigidLabelSelection",
                box.SegmentationToTriangleMesh.rigid_labels.__doc__,
                icon="cell",
            ),
        },
    ),
    panel.box_widget(
        box.SegmentationToTriangleMesh.box_corner,
        box.SegmentationToTriangleMesh.box_size,
        panel.shown_if("BoxInView", "none", inverse=True),
    ),
    panel.last_error(),
)
class SegmentationToTriangleMesh(box.SegmentationToTriangleMesh):
    __doc__ = box.SegmentationToTriangleMesh.__doc__


@smproxy.filter(
    name="ElastixNodalDisplacement", label="Elastix Nodal Displacement", support_reload=False
)
@in_menu
@form(
    panel.documentation(filters.ElastixNodalDisplacement),
    panel.inputs(filters.ElastixNodalDisplacement),
    panel.settings(filters.ElastixNodalDisplacement),
    panel.last_error(),
)
class ElastixNodalDisplacement(filters.ElastixNodalDisplacement):
    __doc__ = filters.ElastixNodalDisplacement.__doc__


@smproxy.filter(name="LameIdentification", label="Lame Identification", support_reload=False)
@in_menu
@smhint.xml('<View type="None" port="1"/>')  # the table is shown when it is asked for
@form(
    panel.documentation(filters.LameIdentification),
    panel.outputs("Map", "Labels"),
    panel.inputs(
        filters.LameIdentification,
        {
            "mesh": '<InputArrayDomain name="displacements" attribute_type="point" '
            'number_of_components="3"/>'
        },
    ),
    panel.report(),
    panel.array_selection(
        "Displacements",
        "GetDisplacementArraySelection",
        "The trials: point arrays with the displacement of every node.",
    ),
    panel.settings(filters.LameIdentification),
    panel.last_error(),
)
class LameIdentification(filters.LameIdentification):
    __doc__ = filters.LameIdentification.__doc__
    output_types = ("vtkUnstructuredGrid", "vtkTable")

    def __init__(self, **settings):
        super().__init__(**settings)
        legends.install()

    def execute(self, meshes, progress):
        """Return the mesh with the result arrays, and the table of labels."""
        grid = super().execute(meshes, progress)
        return grid, label_table(grid)

    def GetReport(self):
        """Return what the last run has to say, a line each; "" before the first one."""
        meshes = display.leaves(self.GetOutputDataObject(0))
        return "\n\n".join(filter(None, map(display.report, meshes)))


# ---- File ▸ Save Data


def _written(filter_class):
    """Return the XML of a writer."""
    return (
        panel.documentation(filter_class),
        panel.inputs(filter_class),
        panel.settings(filter_class, {"file_name": panel.target(filter_class.file_name)}),
        panel.last_error(),
    )


@smproxy.writer(
    name="NiftiMapWriter",
    label="Nifti Map Writer",
    extensions="nii.gz nii gz",
    file_description="ElastoIdentify: maps as NIfTI",
    support_reload=False,
)
@form(*_written(writers.NiftiWriter))
class NiftiMapWriter(writers.NiftiWriter):
    __doc__ = writers.NiftiWriter.__doc__


@smproxy.writer(
    name="DicomMapWriter",
    label="Dicom Map Writer",
    extensions="dcm",
    file_description="ElastoIdentify: maps as DICOM, in a folder",
    support_reload=False,
)
@form(*_written(writers.DicomWriter))
class DicomMapWriter(writers.DicomWriter):
    __doc__ = writers.DicomWriter.__doc__


@smproxy.writer(
    name="HtmlMapWriter",
    label="Html Map Writer",
    extensions="html",
    file_description="ElastoIdentify: page with picture and figures",
    support_reload=False,
)
@form(*_written(writers.HtmlWriter))
class HtmlMapWriter(writers.HtmlWriter):
    __doc__ = writers.HtmlWriter.__doc__
