"""Between Slicer's MRML nodes and the arrays of elastoidentify.

`exports`  a result → DICOM, NIfTI, an HTML page
`images`   volumes, segmentations and transforms → arrays, in world RAS
`outputs`  arrays → model, transforms, table, plot, in one subject hierarchy folder
`request`  what the user asked for, and what is missing
`run`      one run in the background
`sample`   the phantoms of Sample Data
`views`    what the main window shows of a result
"""
