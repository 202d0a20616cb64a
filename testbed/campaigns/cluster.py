"""Bundles on Dask: local workers by default, or any cluster by its address.

Guest    `distributed` and `dask`, of the extra "cluster"
Memory   few bundles are in flight, and their outcomes are let go as they come: the number of runs
         does not matter
Workers  import this module first, so that it leaves alone what only the command needs
"""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from testbed.campaigns.bundle import Bundle, Outcome, carry_out_bundle
from testbed.core.base.errors import ExperimentError, TestbedError

if TYPE_CHECKING:
    from testbed.campaigns.conduct import Answers, Supply
import signal
import warnings

Work: TypeAlias = Callable[[Bundle], tuple[list[Outcome], float]]
"""What is done with a bundle."""

AHEAD = 2
"""Bundles in flight for each worker: one that is done, one that waits."""

ALLOWED_DEATHS = 2
"""Workers that may die with a bundle before it is taken apart, or a run counts as killed."""

LOOK = 2.0
"""Seconds between two looks at how many workers there are."""

_GONE = ("CancelledError", "CommClosedError", "FutureCancelledError", "FuturesCancelledError")

_ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)
_CONFIG: dict[str, Any] = {
    "distributed.scheduler.allowed-failures": ALLOWED_DEATHS,
    "distributed.scheduler.worker-saturation": 1.0,  # a worker that dies takes one bundle along
    "distributed.comm.timeouts.connect": "60s",
    "distributed.deploy.lost-worker-timeout": "1s",
    "distributed.nanny.pre-spawn-environ": _ONE_THREAD,
    "distributed.worker.preload": ["testbed.campaigns.cluster"],
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.target": False,
}


@dataclass(frozen=True)
class Tls:
    """Files of an encrypted connection, PEM each.

    Attributes:
        authority: Certificate of the authority that both sides trust.
        certificate: Ours.
        key: Of ours.
    """

    authority: Path
    certificate: Path
    key: Path


class SchedulerLost(TestbedError):
    """The scheduler has gone while runs were under way."""


@contextmanager
def local_workers(count: int | None, work: Work = carry_out_bundle) -> Iterator[DaskEngine]:
    """Workers of this machine, a process of one thread each, for as long as the block lasts.

    Scheduler and dashboard listen on the loopback, on free ports.

    Args:
        count: How many; default one a processor.
        work: What is done with a bundle.

    Raises:
        ExperimentError: Dask is not installed, or a worker could not be started.
    """
    dask, distributed = _libraries()
    number = count or len(os.sched_getaffinity(0))
    with ExitStack() as stack:
        stack.enter_context(dask.config.set(_CONFIG))
        stack.enter_context(_quiet())
        try:
            cluster = stack.enter_context(
                distributed.LocalCluster(
                    n_workers=number,
                    threads_per_worker=1,
                    host="127.0.0.1",
                    dashboard_address="127.0.0.1:0",
                    silence_logs=logging.CRITICAL,
                )
            )
        except (OSError, RuntimeError) as error:  # one was killed, or lacked memory
            raise ExperimentError(f"the workers could not be started: {error}") from None
        # a worker that dies while it starts is given up by its nanny: another one is started
        cluster.adapt(minimum=number, maximum=number, interval="1s")
        client = stack.enter_context(distributed.Client(cluster, set_as_default=False))
        yield DaskEngine(client, work)


@contextmanager
def workers_at(
    address: str, tls: Tls | None = None, work: Work = carry_out_bundle, patience: str = "30s"
) -> Iterator[DaskEngine]:
    """The workers of a cluster that somebody has started.

    Args:
        address: Of its scheduler, as tcp://host:8786.
        tls: Files of an encrypted connection; None for an open one.
        work: What is done with a bundle.
        patience: How long it may take to answer.

    Raises:
        ExperimentError: Dask is not installed, or nobody answers there.
    """
    dask, distributed = _libraries()
    security: dict[str, Any] = {}
    if tls is not None:
        security["security"] = distributed.Security(
            tls_ca_file=str(tls.authority),
            tls_client_cert=str(tls.certificate),
            tls_client_key=str(tls.key),
            require_encryption=True,
        )
    with dask.config.set({"distributed.comm.timeouts.connect": patience}), _quiet():
        try:
            client = distributed.Client(address, set_as_default=False, timeout=patience, **security)
        except (OSError, ValueError, TypeError, ImportError) as error:
            raise ExperimentError(f"no scheduler answers at '{address}': {error}") from None
        try:
            yield DaskEngine(client, work)
        finally:
            with suppress(OSError, TimeoutError):
                client.close(timeout=5)


class DaskEngine:
    """Bundles go to the workers of a client's cluster."""

    def __init__(self, client: Any, work: Work) -> None:
        """Of a client that is connected."""
        self._client, self._work = client, work
        self._workers, self._looked = 1, 0.0

    def answers(self, supply: Supply) -> Answers:
        """Outcomes of all that a supply hands out, as they come.

        Raises:
            SchedulerLost: The scheduler has gone.
            ExperimentError: The workers cannot do the work at all.
        """
        flow = _libraries()[1].as_completed(loop=self._client.loop)
        under_way: dict[Any, Bundle] = {}
        apart: list[Bundle] = []
        try:
            self._fill(flow, under_way, apart, supply)
            while under_way:
                future = next(flow)
                bundle = under_way.pop(future)
                answer = self._answer(future, bundle, apart)
                self._fill(flow, under_way, apart, supply)
                if answer is not None:
                    yield answer
        finally:
            if under_way:
                with suppress(Exception):  # whatever ends it, the workers need not go on
                    self._client.cancel(list(under_way), force=True)

    def _fill(
        self, flow: Any, under_way: dict[Any, Bundle], apart: list[Bundle], supply: Supply
    ) -> None:
        """Send bundles until every worker has enough of them."""
        workers = self._count()
        while len(under_way) < AHEAD * workers:
            bundle = apart.pop() if apart else supply.take(workers)
            if bundle is None:
                return
            future = self._client.submit(self._work, bundle, pure=False)
            under_way[future] = bundle
            flow.add(future)

    def _count(self) -> int:
        """How many workers there are, one at least."""
        if time.monotonic() - self._looked > LOOK:
            with suppress(Exception):  # a scheduler that is lost is found out by its bundles
                self._workers = max(1, sum(self._client.nthreads().values()))
            self._looked = time.monotonic()
        return self._workers

    def _answer(
        self, future: Any, bundle: Bundle, apart: list[Bundle]
    ) -> tuple[list[Outcome], float] | None:
        """What came of a bundle; None if it has to be taken apart."""
        if future.status in ("cancelled", "lost"):
            raise _lost()
        try:
            found: tuple[list[Outcome], float] = future.result()
        except _libraries()[1].KilledWorker:
            if len(bundle.runs) > 1:
                apart.extend(replace(bundle, runs=(run,)) for run in bundle.runs)
                return None
            (run, _) = bundle.runs[0]
            said = f"{ALLOWED_DEATHS + 1} workers died with it, perhaps for lack of memory"
            return [Outcome(run, "killed", said)], 1.0
        except TestbedError:
            raise
        except Exception as error:
            name = type(error).__name__
            if name in _GONE:
                raise _lost() from None
            raise ExperimentError(f"the workers cannot do it: {name}: {error}") from None
        finally:
            future.release()
        return found


def _lost() -> SchedulerLost:
    return SchedulerLost(
        "the scheduler is gone; what had come is kept, the same command goes on with the rest"
    )


def _libraries() -> tuple[Any, Any]:
    """Dask's two packages.

    Raises:
        ExperimentError: They are not installed.
    """
    try:
        import dask
        import distributed
    except ImportError as error:
        raise ExperimentError(
            f"workers need Dask ({error}): pip install '.[cluster]' in the project's folder; "
            "--workers 0 does without"
        ) from None
    return dask, distributed


@contextmanager
def _quiet() -> Iterator[None]:
    """Dask's own words about workers that come and go are not for the person."""
    loggers = [logging.getLogger(name) for name in ("distributed", "tornado", "asyncio")]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)


def dask_setup(worker: object) -> None:
    """Leave Ctrl-C to the command, and load what every run needs."""
    del worker
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    warnings.simplefilter("ignore")
