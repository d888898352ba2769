"""The ``surefoot`` command, a file a sub-command."""
