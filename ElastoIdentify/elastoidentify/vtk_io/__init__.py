"""Between arrays and VTK: meshes, images, files."""
