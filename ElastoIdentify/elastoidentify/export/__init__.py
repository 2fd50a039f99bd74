"""Out of the box: the map as other programs read it, and figures over several maps.

Plain arrays in, files out; every writer is whole or not at all. :mod:`.cell_map` is what all of
them take, :mod:`.sampling` brings it onto an image's grid.
"""
