"""Files damaged at random."""

import numpy as np

# In place of a stretch: what texts hold between numbers, and numbers that are none.
TOKENS = [b"nan", b"-1e308", b"1e999", b"<", b"&", b",", b"\n", b"\0", b"9" * 400, b"../../x", "é".encode("utf-16")]


def mutated(content: bytes, generator: np.random.Generator) -> bytes:
    """Return a content cut short, or with bytes of its head or anywhere changed, left out, repeated or put in."""
    data, kind = bytearray(content), generator.integers(7)
    if kind == 0:
        return bytes(data[: generator.integers(len(data))])
    for _ in range(int(generator.integers(1, 9))):
        until = min(len(data), 400) if generator.random() < 0.5 else len(data)
        at, span = int(generator.integers(max(until, 1))), int(generator.integers(1, 200))
        if kind == 1:
            data[at : at + 1] = bytes([generator.integers(256)])
        elif kind == 2:
            del data[at : at + span]
        elif kind == 3:
            data[at:at] = data[at : at + span]
        elif kind == 4:
            data[at:at] = generator.bytes(span)
        elif kind == 5:
            data[at : at + 8] = bytes([generator.choice([0x00, 0xFF, 0x7F])]) * len(data[at : at + 8])
        else:
            data[at : at + 1] = TOKENS[int(generator.integers(len(TOKENS)))]
    return bytes(data)
