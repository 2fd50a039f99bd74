"""The map as DICOM, read back

A map leaves as DICOM Parametric Maps in kPa with the code for elasticity, on the rest image's
grid; labels as a segmentation. `elastoidentify run --dicom FOLDER` does the same.
"""

import numpy as np
import pydicom
from elastoidentify.export.cell_map import from_grid
from elastoidentify.export.dicom import Person, write_dicom
from elastoidentify.imaging.phantom import make_phantom
from elastoidentify.pipeline import make_mesh, run
from elastoidentify.study import Study
from elastoidentify.vtk_io.arrays import write_outcome
from matplotlib import pyplot as plt

block = make_phantom(pixels=80, elements=24)
study = Study(
    segmentation=block.segmentation,
    edge_length=10 * block.rest.spacing[0],
    rigid_labels=block.rigid_labels,
    known_materials=[(1, 5000.0, 0.45)],
    method="regularized",
    grouping="label",
    noise=0.02,  # mm
)
mesh = make_mesh(study)  # the true displacements stand in for a registration here
outcome = run(study, mesh=mesh, displacements=block.displacements(mesh.points))
files = write_dicom(
    "dicom", from_grid(write_outcome(outcome)), block.rest, person=Person("P1", "Phantom^One")
)
print(", ".join(sorted(file.name for file in files)))

read = pydicom.dcmread("dicom/mu.dcm")
mapping = read.SharedFunctionalGroupsSequence[0].RealWorldValueMappingSequence[0]
quantity = mapping.QuantityDefinitionSequence[0].ConceptCodeSequence[0]
unit = mapping.MeasurementUnitsCodeSequence[0]
values = np.frombuffer(read.FloatPixelData, np.float32).reshape(read.Rows, read.Columns)
print(f"{quantity.CodeMeaning} ({quantity.CodeValue}, {quantity.CodingSchemeDesignator})")
print(f"largest μ: {np.nanmax(values):.2f} {unit.CodeValue}, truth {9 / 2.9:.2f}")

plt.imshow(values)
plt.colorbar(label="μ (kPa)")
plt.savefig("dicom.png")
