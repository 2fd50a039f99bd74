"""The way from images to meshes and displacements. Needs the extras of the package.

Nothing here is imported with ``import elastoidentify``: the numerics stay plain numpy and scipy.
"""
