"""MGSR: posed photographs in, surface mesh and clean renders out. Importing this needs torch and numpy alone."""

__version__ = "0.1.0"
