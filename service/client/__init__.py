"""A client of the service: sends a capture, follows its job, fetches the results."""
