"""The inverse problem: from displacements to moduli, and how far they can be trusted."""
