"""What a library exports, read from its file: ELF, Mach-O and PE of 64 bits, any processor's."""

from __future__ import annotations

import struct
from collections.abc import Iterator


def exported(raw: bytes) -> set[str]:
    """The names that the library ``raw`` exports, without the underscore that Mach-O puts in front."""
    read = {b"\x7fELF": _elf, b"\xcf\xfa\xed\xfe": _mach_o}.get(raw[:4], _pe)
    return {_text(raw, place) for place in read(raw)}


def _text(raw: bytes, place: int) -> str:
    return raw[place : raw.index(b"\0", place)].decode().removeprefix("_")


def _elf(raw: bytes) -> Iterator[int]:
    """Where the names of dynamic symbols are that the library defines."""
    (first,), size, count = struct.unpack_from("<Q", raw, 40), *struct.unpack_from("<HH", raw, 58)
    sections = [struct.unpack_from("<IIQQQQIIQQ", raw, first + size * n) for n in range(count)]
    for _, kind, _, _, offset, length, link, *_ in sections:
        for place in range(offset, offset + length, 24) if kind == 11 else ():
            name, info, _, section = struct.unpack_from("<IBBH", raw, place)
            if section and info >> 4 == 1:
                yield sections[link][4] + name


def _mach_o(raw: bytes) -> Iterator[int]:
    """Where the names of external symbols are that the library defines, behind their underscore."""
    (commands,), place = struct.unpack_from("<I", raw, 16), 32
    for _ in range(commands):
        kind, size = struct.unpack_from("<II", raw, place)
        if kind == 2:
            symbols, count, names, _ = struct.unpack_from("<IIII", raw, place + 8)
            for n in range(count):
                name, info = struct.unpack_from("<IB", raw, symbols + 16 * n)
                if info & 0x0F == 0x0F:
                    yield names + name
        place += size


def _pe(raw: bytes) -> Iterator[int]:
    """Where the names in the table of exports are."""
    (head,) = struct.unpack_from("<I", raw, 60)
    assert raw[head : head + 4] == b"PE\0\0", raw[:4]
    (count,), (options,) = struct.unpack_from("<H", raw, head + 6), struct.unpack_from("<H", raw, head + 20)
    sections = [struct.unpack_from("<8sIIII", raw, head + 24 + options + 40 * n) for n in range(count)]

    def offset(address: int) -> int:
        return next(at + address - begin for _, _, begin, size, at in sections if begin <= address < begin + size)

    table = offset(struct.unpack_from("<I", raw, head + 24 + 112)[0])
    number, _, names = struct.unpack_from("<III", raw, table + 24)
    for n in range(number):
        yield offset(struct.unpack_from("<I", raw, offset(names) + 4 * n)[0])
