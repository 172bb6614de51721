"""The HTTP service around MGSR: takes jobs, reports their progress and serves their results."""
