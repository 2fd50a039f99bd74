"""Finite elements: cells, meshes, constitutive laws, assembly, the forward problem."""
