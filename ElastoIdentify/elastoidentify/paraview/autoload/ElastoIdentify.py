"""What ParaView loads at start when this folder is on PV_PLUGIN_PATH (every file in it)."""

from elastoidentify.paraview.ElastoIdentifyPlugin import (
    DicomMapWriter,
    ElastixNodalDisplacement,
    ElastoIdentifyDicomFolder,
    ElastoIdentifyImage,
    HtmlMapWriter,
    LameIdentification,
    NiftiMapWriter,
    PushingPhantom,
    SegmentationToTriangleMesh,
    paraview_plugin_name,
    paraview_plugin_version,
)

__all__ = [
    "DicomMapWriter",
    "ElastixNodalDisplacement",
    "ElastoIdentifyDicomFolder",
    "ElastoIdentifyImage",
    "HtmlMapWriter",
    "LameIdentification",
    "NiftiMapWriter",
    "PushingPhantom",
    "SegmentationToTriangleMesh",
    "paraview_plugin_name",
    "paraview_plugin_version",
]
