"""What the user asked for, what is missing in it, and the study that follows."""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import slicer
import vtk
from elastoidentify.errors import InputError
from elastoidentify.imaging.slices import slice_of_image
from elastoidentify.options import Rows
from elastoidentify.study import Study
from slicer.i18n import tr as _

from . import images, parameters

KNOWN, UNKNOWN, RIGID, LEFT_OUT = "known", "unknown", "rigid", "left out"
ROLES = (UNKNOWN, KNOWN, RIGID, LEFT_OUT)


def role_names() -> list[str]:
    """Return what the roles are called in the user's language, in the order of :data:`ROLES`."""
    return [_("unknown"), _("known"), _("rigid"), _("left out")]


@dataclass
class Material:
    """What is said of one segment.

    Parameters
    ----------
    role : str
        One of :data:`ROLES`.
    young : float
        Young's modulus of a known segment; its unit is that of the map.
    poisson : float
        Poisson's ratio of a known segment.
    """

    role: str = UNKNOWN
    young: float = 5.0
    poisson: float = 0.45


def materials_to_text(materials: dict[str, Material]) -> str:
    """Write materials by segment id as text for a parameter node."""
    return json.dumps({segment: vars(material) for segment, material in materials.items()})


def materials_from_text(text: str) -> dict[str, Material]:
    """Read what :func:`materials_to_text` wrote."""
    return {segment: Material(**values) for segment, values in json.loads(text or "{}").items()}


def segment_names(segmentation) -> dict[str, str]:
    """Return {segment id: name}, in the order of the segmentation."""
    if segmentation is None:
        return {}
    segments = segmentation.GetSegmentation()
    ids = [segments.GetNthSegmentID(n) for n in range(segments.GetNumberOfSegments())]
    return {segment_id: segments.GetSegment(segment_id).GetName() for segment_id in ids}


MATERIAL_TAG = "ElastoIdentify.Material"


def tag_segment(segmentation, segment_id: str, material: Material) -> None:
    """Write a material into the segmentation itself, as what the panel suggests for the segment."""
    segment = segmentation.GetSegmentation().GetSegment(segment_id)
    segment.SetTag(MATERIAL_TAG, json.dumps(vars(material)))


def suggested_material(segmentation, segment_id: str) -> Material:
    """Return what :func:`tag_segment` wrote; an unknown material where it wrote nothing."""
    text = vtk.reference("")
    segment = segmentation.GetSegmentation().GetSegment(segment_id)
    if segment is not None and segment.GetTag(MATERIAL_TAG, text):
        return Material(**json.loads(str(text)))
    return Material()


@dataclass
class Request:
    """Nodes and choices of one run, as the panel or a script gives them.

    Parameters
    ----------
    restVolume : vtkMRMLScalarVolumeNode
    segmentation : vtkMRMLSegmentationNode
    materials : {segment id or name: Material}
        Segments that are not named have the material of their tag; without one, unknown.
    pushedVolumes : sequence of vtkMRMLScalarVolumeNode
        One per trial.
    transforms : sequence of vtkMRMLTransformNode
        One per trial; given, they are used instead of a registration of the pushed volumes.
    transformsToRest : bool
        The transforms take pushed points to where they were at rest (as a registration does whose
        fixed image is the rest image), instead of the other way round.
    maskVolume : vtkMRMLScalarVolumeNode, optional
        Images are compared where it is not 0.
    reactionRois : sequence of vtkMRMLMarkupsROINode
        Boxes in which an outside body may push.
    edgeLength : float
        Of the mesh's cells, mm; 0: twelve voxels.
    wholeVolume : bool
        Mesh the volume with tetrahedra; False: one slice with triangles.
    sliceAxis, sliceIndex : int
        The slice: axis 0, 1, 2 for i, j, k; a negative index is the middle one. Volumes of one
        slice need no choice.
    options : dict
        Any other option of :class:`elastoidentify.study.Study` by its name: method, kinematics, …
    unit : str
        Of Young's modulus, for display.
    """

    restVolume: object = None
    segmentation: object = None
    materials: dict[str, Material] = field(default_factory=dict)
    pushedVolumes: Sequence = ()
    transforms: Sequence = ()
    transformsToRest: bool = False
    maskVolume: object = None
    reactionRois: Sequence = ()
    edgeLength: float = 0.0
    wholeVolume: bool = False
    sliceAxis: int = 2
    sliceIndex: int = -1
    options: dict = field(default_factory=dict)
    unit: str = "kPa"

    def material(self, segment_id: str, name: str) -> Material:
        """Return what is said of a segment, by its id or its name."""
        given = self.materials.get(segment_id) or self.materials.get(name)
        return given or suggested_material(self.segmentation, segment_id)

    def segments(self) -> dict[str, tuple[int, str, Material]]:
        """Return {segment id: (label, name, material)} of the segments that are not left out."""
        table = {}
        for segment_id, name in segment_names(self.segmentation).items():
            material = self.material(segment_id, name)
            if material.role != LEFT_OUT:
                table[segment_id] = (len(table) + 1, name, material)
        return table

    def missing(self, use_transforms: bool | None = None) -> str:
        """Say in a few words what is missing before work can start; empty when nothing is."""
        if use_transforms is None:
            use_transforms = bool(self.transforms)
        if self.restVolume is None:
            return _("choose a rest volume")
        if use_transforms and not self.transforms:
            return _("choose a transform per trial")
        if not use_transforms and not self.pushedVolumes:
            return _("choose pushed volumes")
        if not use_transforms and self.restVolume in self.pushedVolumes:
            return _("the rest volume is also chosen as pushed")
        if self.segmentation is None:
            return _("choose a segmentation")
        segments = self.segments().values()
        if not segments:
            return _("the segmentation has no segment to use")
        known = [(name, material) for label, name, material in segments if material.role == KNOWN]
        if not known:
            return _("say which segment is known")
        if not any(material.role == UNKNOWN for *names, material in segments):
            return _("no segment is unknown")
        for name, material in known:
            if not material.young > 0:
                return _("Young's modulus of {name} must be positive").format(name=name)
            if not -1 < material.poisson < 0.5:
                text = _("Poisson's ratio of {name} must be between -1 and 0.5")
                return text.format(name=name)
        if self.edgeLength < 0:
            return _("the edge length must be positive")
        return ""

    def study(self) -> Study:
        """Return the study for the library, in world RAS.

        Raises
        ------
        InputError
            Something is missing, an option is not allowed, or a node cannot be used.
        """
        lack = self.missing()
        if lack:
            raise InputError(f"{lack[0].upper()}{lack[1:]}.")
        segments = self.segments()
        rest = images.image_from_volume(self.restVolume)
        labels = images.segmentation_image(self.segmentation, list(segments), self.restVolume)
        axis, index = self._slice(rest)
        present = set(np.unique(_at(labels, axis, index).array).tolist())
        for label, name, material in segments.values():
            if label not in present and material.role == KNOWN:
                text = _("the known segment {name!r} is not in this slice: choose another")
                raise InputError(text.format(name=name))
        return Study(
            segmentation=labels,
            rest=rest,
            pushed=[
                images.image_from_volume(volume)
                for volume in (() if self.transforms else self.pushedVolumes)
            ],
            mask=self.maskVolume and images.image_from_volume(self.maskVolume),
            edge_length=self.edgeLength,
            slice_axis=axis,
            slice_index=index,
            reaction_boxes=[images.box_of_roi(roi) for roi in self.reactionRois],
            rigid_labels=[
                label
                for label, _, material in segments.values()
                if material.role == RIGID and label in present
            ],
            known_materials={
                label: (material.young, material.poisson)
                for label, _, material in segments.values()
                if material.role == KNOWN
            },
            unit=self.unit,
            **self._options(),
        )

    def _slice(self, rest) -> tuple[str, int]:
        """Return axis and index of the slice to mesh, as the table of options has them."""
        if self.wholeVolume or rest.planar_axis is not None:
            return "none", -1
        size = rest.size[self.sliceAxis]
        return "ijk"[self.sliceAxis], self.sliceIndex if self.sliceIndex >= 0 else size // 2

    def _options(self) -> dict:
        """Return the options with labels in place of the names of segments."""
        table, found = parameters.options(), dict(self.options)
        for name, value in self.options.items():
            if isinstance(table.get(name), Rows) and isinstance(value, str):
                found[name] = parameters.rows_of_text(value, table[name], self.names())
        return found

    def names(self) -> dict[int, str]:
        """Return {label: name of the segment}."""
        return {label: name for label, name, material in self.segments().values()}

    def inputs(self) -> dict:
        """Return names and fingerprints of the volumes, for the provenance."""
        volumes = {"rest": self.restVolume, "mask": self.maskVolume}
        found = {k: images.fingerprint(v) for k, v in volumes.items() if v is not None}
        if self.pushedVolumes and not self.transforms:
            found["pushed"] = [images.fingerprint(volume) for volume in self.pushedVolumes]
        return found


def _at(image, axis: str, index: int):
    return image if axis == "none" else slice_of_image(image, "ijk".index(axis), index)


def suggested_rest():
    """Return the volume that is called rest, else the first that is not called pushed, or None."""
    volumes = {node: node.GetName().lower() for node in _visible("vtkMRMLScalarVolumeNode")}
    called = [node for node, name in volumes.items() if re.search(r"(?<![a-z])rest(?![a-z])", name)]
    others = [node for node, name in volumes.items() if "push" not in name]
    return next(iter(called + others), None)


def suggested_segmentation():
    """Return the first segmentation, or None."""
    return next(iter(_visible("vtkMRMLSegmentationNode")), None)


def _visible(class_name: str) -> list:
    """Return the nodes of just this class that the user can see."""
    nodes = slicer.util.getNodesByClass(class_name)
    nodes = [node for node in nodes if node.GetClassName() == class_name]
    return [node for node in nodes if not node.GetHideFromEditors()]
