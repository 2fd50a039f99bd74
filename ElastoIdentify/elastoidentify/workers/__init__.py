"""Processes in the background: a whole job, and elastix."""
