"""The source paper's example, and the demo."""
