"""`python -m testbed.cli` is `testbed`."""

from testbed.cli.main import main

main()
