"""Many runs: nothing lost, nothing twice.

Arrow, which keeps the tables, asks the system for memory and gives it back, unless somebody has
said otherwise: its own pools keep what they once had, a fifth of what a large campaign needs.

In: an experiment file with factors.
Out: one Parquet table, its summary and page.
"""

import os

os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")  # read where Arrow is imported
