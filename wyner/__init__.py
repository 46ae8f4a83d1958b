"""The ``wyner`` command: one module a subcommand, found in :mod:`wyner.cli`."""
