"""The console program `mgsr`: the library's commands and the service's, which know nothing of each other."""
