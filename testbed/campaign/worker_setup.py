"""What a local worker does first: Dask imports this module and calls `dask_setup`."""

from __future__ import annotations

import signal
import warnings


def dask_setup(worker: object) -> None:
    """Leave Ctrl-C to the command, and load what every run needs.

    Args:
        worker: Dask's.
    """
    del worker
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    warnings.simplefilter("ignore")
