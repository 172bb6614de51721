"""The console programs.

`mgsr` has the commands of the library and of the service, which do not import each other. `mgsr-worker` has the
commands of the worker and the library's `run`.
"""
