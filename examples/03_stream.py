"""Streams poses and gets frames back: python examples/03_stream.py [URL]; a service runs."""

import argparse
import asyncio

from clients.calls import DEFAULT_URL
from clients.client import AsyncDrapeClient
from clients.stream import DrapeStream

asked = argparse.ArgumentParser(description=__doc__)
asked.add_argument("url", nargs="?", default=DEFAULT_URL, help="the service")
URL = asked.parse_args().url


async def main() -> None:
    async with AsyncDrapeClient(URL) as client:
        clip = (await client.motion("walk")).resampled(30.0).window(0, 30)
    ages = []
    async with await DrapeStream.open(URL, "tshirt") as stream:
        for pose, trans in zip(clip.poses, clip.trans, strict=True):
            await stream.send(pose, trans)
            received = await stream.receive()
            ages.append(1000 * received.age_s)
            await asyncio.sleep(1 / 30)
    ages.sort()
    print(f"{len(ages)} frames of {len(received.frame.vertices())} vertices, half of them within {ages[15]:.0f} ms")


asyncio.run(main())
