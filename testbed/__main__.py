"""Entry point of `python -m testbed`, the same as the command `testbed`."""

from testbed.cli.main import main

main()
