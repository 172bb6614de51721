"""What docs/evidence.md says, made from benchmarks/results; `python -m benchmarks.evidence` writes the page."""
