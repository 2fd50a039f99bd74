"""From image files."""

import os
import re
from pathlib import Path

import numpy as np
from vtkmodules.vtkCommonDataModel import vtkDataObject, vtkImageData
from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline as _Pipeline

from ..errors import InputError
from ..imaging.io.reading import read_as
from ..options import Choice, File
from ..study import ReadOptions
from ..vtk_io.convert import get_text, image_to_vtk, set_text
from ..workers.borrowed import call
from .base import Filter

SUFFIXES = ("nrrd", "nhdr", "nii", "nii.gz", "hdr", "img", "mha", "mhd", "dcm", "ima")
LABELS, NOTES, FILE_NAME = "Label", "ImageNotes", "ImageFile"


class ImageFile(Filter, tables=(ReadOptions,)):
    """Read NRRD, NIfTI, MetaImage and DICOM, files or folders, with their place in the world.

    A source. Output: vtkImageData with origin, spacing and direction of the file, in the world of
    ITK (LPS). Its one point array has the name of the file, and of a segmentation it is ``Label``,
    which ParaView shows as categories. Several files are the time steps of a series, as a push per
    file. Files that are damaged, or that do not say where they are, are refused in one line. What
    was assumed is a warning.
    """

    ports = ()
    output_types = ("vtkImageData",)

    file_names = File(
        "Image file, or a folder of DICOM files; several are the steps of a series.",
        extensions=" ".join(SUFFIXES),
        description="images with orientation",
    )
    kind = Choice(
        "auto",
        "Grey values, or the labels of a segmentation; auto: a segmentation where the file can be "
        "nothing else (.seg.nrrd, DICOM SEG and RTSTRUCT).",
        ("auto", "image", "segmentation"),
    )

    def __init__(self, **settings):
        self._time, self._read, self._refusal = 0.0, {}, None
        super().__init__(**settings)

    # ---- which files

    def AddFileName(self, path):
        """Add the file or folder of one more step."""
        self.file_names = [*self._paths(), path]

    def ClearFileNames(self):
        """Take all files off."""
        self.file_names = ""

    def _paths(self) -> list[str]:
        names = self.file_names
        return [names] if isinstance(names, str) and names else list(names)

    def GetTimestepValues(self):
        """Return the times of the steps, None of a single image."""
        return list(map(float, range(len(self._paths())))) if len(self._paths()) > 1 else None

    # ---- work

    def RequestInformation(self, request, inInfo, outInfo):
        """Tell the extent and the times. What cannot be read is said when it is asked for."""
        info = outInfo.GetInformationObject(0)
        times = self.GetTimestepValues()
        for key in (_Pipeline.TIME_STEPS(), _Pipeline.TIME_RANGE()):
            info.Remove(key)
        if times:
            info.Set(_Pipeline.TIME_STEPS(), times, len(times))
            info.Set(_Pipeline.TIME_RANGE(), (times[0], times[-1]), 2)
        try:
            self._refusal, image = None, self._image(0, None)
        except (Exception, KeyboardInterrupt) as error:
            self._refusal, image = error, vtkImageData()
        info.Set(_Pipeline.WHOLE_EXTENT(), image.GetExtent(), 6)
        info.Set(vtkDataObject.ORIGIN(), image.GetOrigin(), 3)
        info.Set(vtkDataObject.SPACING(), image.GetSpacing(), 3)
        matrix = image.GetDirectionMatrix()
        rows = [matrix.GetElement(i, j) for i in range(3) for j in range(3)]
        info.Set(vtkDataObject.DIRECTION(), rows, 9)
        return 1

    def RequestData(self, request, inInfo, outInfo):
        """Read the step that is asked for."""
        info = outInfo.GetInformationObject(0)
        asked = info.Has(_Pipeline.UPDATE_TIME_STEP())
        self._time = info.Get(_Pipeline.UPDATE_TIME_STEP()) if asked else 0.0
        done = super().RequestData(request, inInfo, outInfo)
        if self.GetTimestepValues():
            data = info.Get(vtkDataObject.DATA_OBJECT())
            data.GetInformation().Set(vtkDataObject.DATA_TIME_STEP(), float(self._step_asked()))
        return done

    def _step_asked(self) -> int:
        return int(np.clip(round(self._time), 0, max(len(self._paths()) - 1, 0)))

    def execute(self, progress):
        """Return the image of the step that is asked for."""
        if not self._paths():
            raise InputError("no file given: choose an image file, or a folder of DICOM files")
        if self._refusal is not None:
            refusal, self._refusal = self._refusal, None
            raise refusal
        first, image = self._image(0, progress), self._image(self._step_asked(), progress)
        if image.GetDimensions() != first.GetDimensions():
            raise InputError(
                f"{self._paths()[self._step_asked()]}: has {_size(image)} voxels and the first of "
                f"the series {_size(first)}; open them one by one"
            )
        return image

    def _image(self, step: int, progress) -> vtkImageData:
        """Return the image of a step; each file is read once, unless it changes."""
        path = self._paths()[step] if self._paths() else ""
        if not path:
            return vtkImageData()
        key = (path, _when(path), self.kind, self.series, self.frame)
        if self._read.get(path, ("",))[0] != key:
            read = call(
                read_as,
                *(path, self.kind),
                series=self.series or None,
                frame=self.frame or None,
                packages=("SimpleITK", "pydicom"),
                progress=progress,
            )
            self._read[path] = key, _to_vtk(*read, self._array_name(), path)
        self._read = {one: self._read[one] for one in self._paths() if one in self._read}
        return self._read[path][1]

    def _array_name(self) -> str:
        """Return the name of the first file, of a series without its number."""
        name = Path(self._paths()[0]).name.split(".")[0] or "Image"
        return (re.sub(r"[-_ ]*\d+$", "", name) or name) if len(self._paths()) > 1 else name

    def warnings_of(self, output):
        """Return what was assumed about the file."""
        where = get_text(output, FILE_NAME)
        return [f"{where}: {note}" for note in get_text(output, NOTES).splitlines()]


def _to_vtk(image, names, segmentation: bool, name: str, path: str) -> vtkImageData:
    array = image.array
    if array.dtype == bool:
        image = image.with_array(array.astype(np.uint8))
    data = image_to_vtk(image, LABELS if segmentation else name)
    set_text(data, FILE_NAME, str(path))
    set_text(data, NOTES, "\n".join(image.notes))
    set_text(data, "LabelNames", "\n".join(f"{n}: {words}" for n, words in sorted(names.items())))
    return data


def _when(path: str) -> float:
    try:
        return os.stat(path).st_mtime
    except (OSError, ValueError):
        return 0.0


def _size(image) -> str:
    return " × ".join(map(str, image.GetDimensions()))
