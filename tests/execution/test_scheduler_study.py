"""What one scheduler of dask carries: `pytest -m study -n 0 -s -k scheduler_study`.

A scheduler, real workers in two processes, and a client, each process by itself, so that the processor time of each is
known. In place of simulating a segment of a flight, tasks sleep (`docs/scale.md`).
"""

import asyncio
import multiprocessing
import time

import pytest
from distributed import Client, Scheduler, Worker, as_completed

pytestmark = pytest.mark.study

HOST, TOGETHER = "127.0.0.1", 20
CONTEXT = multiprocessing.get_context("spawn")


def schedule(addresses, stop, spent) -> None:
    """Run a scheduler until it is stopped; its processor time is kept up to date."""

    async def run() -> None:
        async with Scheduler(host=HOST, port=0, dashboard=False) as scheduler:
            addresses.put(scheduler.address)
            while not stop.is_set():
                spent.value = time.process_time()
                await asyncio.sleep(0.2)

    asyncio.run(run())


def work(address, count, stop) -> None:
    """Run workers of one thread each until they are stopped."""

    async def run() -> None:
        workers: list[Worker] = []
        while len(workers) < count:
            more = [Worker(address, nthreads=1, host=HOST, dashboard=False, memory_limit=0) for _ in range(TOGETHER)]
            workers += await asyncio.gather(*more)
        while not stop.is_set():
            await asyncio.sleep(0.2)

    asyncio.run(run())


@pytest.mark.parametrize(("workers", "tasks", "length_s"), [(100, 400, 4.0), (1000, 3000, 20.0)])
def test_all_tasks_come_back(workers, tasks, length_s):
    """A thousand workers do their tasks; printed are the time beside the best one, and what a task costs."""
    addresses, stop, spent = CONTEXT.Queue(), CONTEXT.Event(), CONTEXT.Value("d", 0.0)
    scheduler = CONTEXT.Process(target=schedule, args=(addresses, stop, spent), daemon=True)
    scheduler.start()
    address = addresses.get(timeout=60)
    for _ in range(2):
        CONTEXT.Process(target=work, args=(address, workers // 2, stop), daemon=True).start()
    try:
        with Client(address, timeout=60) as client:
            begin = time.monotonic()
            client.wait_for_workers(workers, timeout=300)
            joined_s = time.monotonic() - begin
            before, own, begin = spent.value, time.process_time(), time.monotonic()
            futures = [client.submit(time.sleep, length_s, key=f"segment-{k}", pure=False) for k in range(tasks)]
            done = sum(future.status == "finished" for future in as_completed(futures))
            took_s = time.monotonic() - begin
            each_ms = [1e3 * took / tasks for took in (time.process_time() - own, spent.value - before)]
    finally:
        stop.set()
        scheduler.join(10)
    print(
        f"{workers} workers joined in {joined_s:.0f} s; {tasks} tasks of {length_s:g} s took {took_s:.1f} s, at best "
        f"{tasks / workers * length_s:.1f}; a task costs the client {each_ms[0]:.2f} ms, the scheduler {each_ms[1]:.2f}"
    )
    assert done == tasks
