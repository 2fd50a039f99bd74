"""An open benchmark of identification: problems × methods; see docs/open-benchmark.md."""
