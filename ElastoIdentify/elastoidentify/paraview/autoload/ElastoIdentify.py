"""What ParaView loads at start when this folder is on PV_PLUGIN_PATH (every file in it)."""

from elastoidentify.paraview.ElastoIdentifyPlugin import (
    ElastixNodalDisplacement,
    ElastoIdentifyDicomFolder,
    ElastoIdentifyImage,
    LameIdentification,
    PushingPhantom,
    SegmentationToTriangleMesh,
    paraview_plugin_name,
    paraview_plugin_version,
)

__all__ = [
    "ElastixNodalDisplacement",
    "ElastoIdentifyDicomFolder",
    "ElastoIdentifyImage",
    "LameIdentification",
    "PushingPhantom",
    "SegmentationToTriangleMesh",
    "paraview_plugin_name",
    "paraview_plugin_version",
]
