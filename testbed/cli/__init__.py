"""The command line.

In: arguments.
Out: calls of the other rooms; exit code 2 with one line where input is wrong.
"""
