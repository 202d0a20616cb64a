"""Command line interface.

In: command-line arguments.
Out: calls of the other packages; exit code 2 with one line where input is wrong.
"""
