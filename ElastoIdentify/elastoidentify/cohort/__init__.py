"""Many subjects: a BIDS App on snakebids and Snakemake that calls ``elastoidentify run`` for each.

``elastoidentify-cohort BIDS OUT participant`` makes a map per subject, ``… group`` one table and
one page of all. The layout of folders is in :mod:`.layout`.
"""
