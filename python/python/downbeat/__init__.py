"""Robot software as small modules in one process: modules, messages and bags in Python."""
