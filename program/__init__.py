"""The console programs: `mgsr` has the commands of the library and of the service, which know nothing of each other;
`mgsr-worker` those of the worker and the library's `run`."""
