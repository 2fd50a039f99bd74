"""Maps written for others by File ▸ Save Data."""

from pathlib import Path

from ..export.cell_map import from_grid
from ..export.delivery import deliver
from ..filters.base import Filter, Port
from ..filters.registration import REST_FILE
from ..options import Choice, File, Text
from ..vtk_io.arrays import read_report
from ..vtk_io.convert import get_text, has_array
from ..workers.borrowed import call

QUANTITIES = {"mu": "Mu", "young": "YoungModulus"}


class MapWriter(Filter):
    """Write a map on the grid of its rest image.

    Input: the output of LameIdentification, or a file of it. Every voxel has the value of the cell
    that its centre lies in.
    """

    ports = (Port("map", "vtkUnstructuredGrid"),)
    output_types = ()
    kind, packages, endings = "", (), ()

    file_name = File("File to write; the maps of several quantities are named after it.")
    rest_image = File(
        "Rest image: file or DICOM folder. Empty: the one that was registered, where ParaView has "
        "read it by the reader of ElastoIdentify.",
        extensions="nrrd nii nii.gz mha dcm",
        description="images",
    )

    def Write(self):
        """Write now; what ParaView calls."""
        self.Modified()
        super(Filter, self).Update()

    def execute(self, grid, progress):
        """Write the files."""
        if not grid.GetNumberOfCells():  # a rank that has nothing of the map
            return ()
        progress(0.0, "writing")
        files, notes = call(
            deliver,
            from_grid(grid, "the mesh"),
            self.kind,
            self._target(),
            str(self.rest_image or get_text(grid, REST_FILE)),
            **self._more(grid),
            packages=self.packages,
            progress=progress,
        )
        names = ", ".join(file.name for file in files)
        self._tell("".join(f"note: {note}\n" for note in notes) + f"wrote {names}\n")
        return ()

    def _target(self) -> Path:
        """Return the file's name without its ending: a prefix, or a folder."""
        path = Path(self.file_name)
        ending = next((one for one in self.endings if path.name.lower().endswith(one)), "")
        return path.with_name(path.name[: len(path.name) - len(ending)])

    def _more(self, grid) -> dict:
        return {}

    def _tell(self, text: str):
        from vtkmodules.vtkCommonCore import vtkOutputWindow

        vtkOutputWindow.GetInstance().DisplayText(text)


class NiftiWriter(MapWriter):
    __doc__ = MapWriter.__doc__
    kind, packages, endings = "nifti", ("SimpleITK", "pydicom"), (".nii.gz", ".nii", ".gz")


class DicomWriter(MapWriter):
    __doc__ = MapWriter.__doc__
    kind, packages, endings = "dicom", ("SimpleITK", "pydicom", "highdicom"), (".dcm",)

    quantity = Choice("mu", "Which modulus, with its standard deviation.", tuple(QUANTITIES))
    patient_id = Text("", "Patient's identifier, of a rest image that is no DICOM.")
    patient_name = Text("", "Patient's name, likewise, as in Doe^Jane.")

    def _more(self, grid) -> dict:
        person = {"patient_id": self.patient_id, "patient_name": self.patient_name}
        return {"quantity": QUANTITIES[self.quantity], **person}


class HtmlWriter(MapWriter):
    __doc__ = MapWriter.__doc__
    kind, packages = "html", ("SimpleITK", "pydicom", "matplotlib")

    def _more(self, grid) -> dict:
        return {
            "warnings": read_report(grid, "registration").get("warnings", []),
            "informed": has_array(grid.GetPointData(), "DisplacementInformation_1"),
        }
