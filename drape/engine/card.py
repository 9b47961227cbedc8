"""A graphics card by its driver: its memory, and launches of the engine's frames (``card_jobs``).

``python -m drape.engine.card`` compiles the kernels for the cards of ``ARCHITECTURES`` with CUDA's ``nvcc``, and needs
no card for it. Calls go to NVIDIA's driver itself, so that nothing else of CUDA need be installed where they run.
"""

from __future__ import annotations

import ctypes
import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drape.engine.build import write_header
from drape.engine.packer import address_of
from drape.engine.records import HASH
from drape.errors import Unavailable

SOURCE = Path(__file__).parent / "source" / "card.cu"
KERNELS = Path(__file__).parent / "libraries" / "card.fatbin"
PACKAGE = "drape_cuda"  # the wheel of the extra ``cuda``, which has the kernels (deploy/cuda)
ARCHITECTURES = (80, 90, 100)  # A100, H100 and H200, B200
DRIVER = "nvcuda.dll" if os.name == "nt" else "libcuda.so.1"
LEAST_CUDA, LEAST_MAJOR, LEAST_BYTES = 13000, 8, 1 << 30  # of the driver, of the card, and of its free memory
CURE = "Mend that, or go on: frames are computed by the processor."
_MAJOR, _MINOR, _CORES = 75, 76, 16  # CUDA's numbers of what a card is asked for
GROUPS_A_CORE = 2  # of threads that a core holds at once, with the registers that the kernels take


def kernels() -> Path | None:
    """Returns the file of the compiled kernels: that of the wheel of the extra ``cuda``, or else the one that this
    module's command writes; None if there is neither."""
    found = importlib.util.find_spec(PACKAGE)
    folders = list(found.submodule_search_locations or ()) if found else []
    paths = [*(Path(folder) / KERNELS.name for folder in folders), KERNELS]
    return next((path for path in paths if path.is_file()), None)


def count_cards(driver: str = DRIVER) -> int:
    """Returns how many cards the library ``driver`` finds; 0 where there is no such library or it fails."""
    try:
        calls = ctypes.CDLL(driver)
    except OSError:
        return 0
    found = ctypes.c_int()
    return 0 if calls.cuInit(0) or calls.cuDeviceGetCount(ctypes.byref(found)) else found.value


class Card:
    """One opened NVIDIA card: its memory, and launches of the kernel in the file ``path``.

    ``number`` is the card's index on this machine, and ``driver`` is NVIDIA's library. ``name`` is the card's, and
    ``groups`` is how many groups of threads it runs at once. A thread calls ``enter`` before it calls anything else.
    Raises ``Unavailable`` where there is no driver or an old one, no card or an old one, too little free memory, or
    kernels that were compiled with another table of records. Every method raises ``OSError`` where the driver reports a
    fault.
    """

    def __init__(self, path: Path, *, number: int = 0, driver: str = DRIVER) -> None:
        try:
            self._calls = ctypes.CDLL(driver)
        except OSError as error:
            raise _missing("NVIDIA's driver", str(error)) from error
        try:
            self._do("cuInit", 0)
        except OSError as error:
            raise _missing("a card that NVIDIA's driver finds", str(error)) from error
        version = self._number("cuDriverGetVersion")
        if version < LEAST_CUDA:
            raise _missing(f"a driver for CUDA {_cuda(LEAST_CUDA)} or later", f"one for {_cuda(version)}")
        if number >= (count := self._number("cuDeviceGetCount")):
            raise _missing(f"more than {number} cards", str(count))
        device = self._number("cuDeviceGet", number)
        name = ctypes.create_string_buffer(128)
        self._do("cuDeviceGetName", name, 127, device)
        self.name = name.value.decode()
        major = self._number("cuDeviceGetAttribute", _MAJOR, device)
        if major < LEAST_MAJOR:
            minor = self._number("cuDeviceGetAttribute", _MINOR, device)
            raise _missing(f"a card of compute capability {LEAST_MAJOR}.0 or later", f"{self.name}, {major}.{minor}")
        self.groups = GROUPS_A_CORE * self._number("cuDeviceGetAttribute", _CORES, device)
        self._context = ctypes.c_void_p()
        self._do("cuDevicePrimaryCtxRetain", ctypes.byref(self._context), device)
        self.enter()
        if self.free_bytes < LEAST_BYTES:
            raise _missing(f"{LEAST_BYTES >> 20} MB free on {self.name}", f"{self.free_bytes >> 20} MB")
        self._frames = self._loaded(path)

    def _loaded(self, path: Path) -> ctypes.c_void_p:
        """The function of the kernel in ``path``."""
        module, kernel = ctypes.c_void_p(), ctypes.c_void_p()
        image = path.read_bytes()
        try:
            self._do("cuModuleLoadData", ctypes.byref(module), image)
        except OSError as error:
            raise _missing(f"{path.name} to have kernels for {self.name}", str(error)) from error
        address, size, own = ctypes.c_uint64(), ctypes.c_size_t(), np.zeros(1, np.uint64)
        self._do("cuModuleGetGlobal_v2", ctypes.byref(address), ctypes.byref(size), module, b"drape_records_hash")
        self.read(address.value, own)
        if int(own[0]) != HASH:
            raise _missing(f"kernels of this engine, {HASH:016x}", f"{path} of {int(own[0]):016x}")
        self._do("cuModuleGetFunction", ctypes.byref(kernel), module, b"drape_frames")
        return kernel

    def enter(self) -> None:
        """Makes the card that of the calling thread."""
        self._do("cuCtxSetCurrent", self._context)

    @property
    def free_bytes(self) -> int:
        """Returns the card's free memory [bytes], as the driver tells it."""
        free, whole = ctypes.c_size_t(), ctypes.c_size_t()
        self._do("cuMemGetInfo_v2", ctypes.byref(free), ctypes.byref(whole))
        return free.value

    def take(self, size: int) -> int:
        """Takes ``size`` bytes of the card's memory and returns their address."""
        address = ctypes.c_uint64()
        self._do("cuMemAlloc_v2", ctypes.byref(address), ctypes.c_size_t(max(size, 1)))
        return address.value

    def write(self, address: int, numbers: np.ndarray) -> None:
        """Copies the array ``numbers`` into the card's memory, to ``address``."""
        given = ctypes.c_void_p(address_of(numbers)), ctypes.c_size_t(numbers.nbytes)
        self._do("cuMemcpyHtoD_v2", ctypes.c_uint64(address), *given)

    def read(self, address: int, numbers: np.ndarray) -> None:
        """Fills the array ``numbers`` from the card's memory at ``address``, once all launches are through."""
        given = ctypes.c_uint64(address), ctypes.c_size_t(numbers.nbytes)
        self._do("cuMemcpyDtoH_v2", ctypes.c_void_p(address_of(numbers)), *given)

    def frames(self, tasks: int, count: int, groups: int, threads: int) -> None:
        """Begins a launch and does not wait for its end: ``groups`` groups of ``threads`` threads share ``count``
        frames.

        The frames' tasks, (count, ``card_jobs.TASK``) uint64, lie on the card at the address ``tasks``.
        """
        given = ctypes.c_uint64(tasks), ctypes.c_int64(count)
        pointers = (ctypes.c_void_p * len(given))(*map(ctypes.addressof, given))
        sizes = (ctypes.c_uint(size) for size in (groups, 1, 1, threads, 1, 1, 0))
        self._do("cuLaunchKernel", self._frames, *sizes, None, pointers, None)

    def timed(self, tasks: int, count: int, groups: int, threads: int, *, rounds: int) -> float:
        """Makes the launch of ``frames`` ``rounds`` times, and returns the time of all together [ms] by the card's
        clock."""
        begin, end = ctypes.c_void_p(), ctypes.c_void_p()
        for event in (begin, end):
            self._do("cuEventCreate", ctypes.byref(event), 0)
        self._do("cuEventRecord", begin, None)
        for _ in range(rounds):
            self.frames(tasks, count, groups, threads)
        self._do("cuEventRecord", end, None)
        self._do("cuEventSynchronize", end)
        took_ms = ctypes.c_float()
        self._do("cuEventElapsedTime", ctypes.byref(took_ms), begin, end)
        for event in (begin, end):
            self._do("cuEventDestroy_v2", event)
        return took_ms.value

    def _number(self, name: str, *given: Any) -> int:
        """The whole number that the call writes first."""
        found = ctypes.c_int()
        self._do(name, ctypes.byref(found), *given)
        return found.value

    def _do(self, name: str, *given: Any) -> None:
        if fault := getattr(self._calls, name)(*given):
            told = ctypes.c_char_p()
            self._calls.cuGetErrorString(fault, ctypes.byref(told))
            raise OSError(f"{name}: {told.value.decode() if told.value else fault}")


def _missing(expected: str, got: str) -> Unavailable:
    return Unavailable("card", expected=expected, got=got, cure=CURE)


def _cuda(version: int) -> str:
    return f"{version // 1000}.{version % 1000 // 10}"


def build_kernels(path: Path = KERNELS, *, architectures: Sequence[int] = ARCHITECTURES) -> str:
    """Compiles the kernels into the file ``path``, for cards of the ``architectures``: compute capabilities times ten.

    Returns the compiler's text on the registers and the memory of each kernel. Raises ``FileNotFoundError`` without
    ``nvcc``, ``OSError`` where it fails.
    """
    nvcc = shutil.which("nvcc")
    if nvcc is None:
        raise FileNotFoundError("nvcc: expected CUDA's compiler on PATH, got none; install CUDA 13.0 or later")
    write_header()
    path.parent.mkdir(parents=True, exist_ok=True)
    codes = [f"-gencode=arch=compute_{one},code=sm_{one}" for one in architectures]
    command = [nvcc, "-std=c++20", "-O3", "-fatbin", "-Xptxas=-v", *codes, str(SOURCE), "-o", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise OSError(f"nvcc: {done.stderr}")
    return done.stderr


if __name__ == "__main__":
    sys.stdout.write(build_kernels())
