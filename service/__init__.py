"""The HTTP service around MGSR: takes jobs, says how they go, hands out what came of them."""
