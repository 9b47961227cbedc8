"""``python -m service.keys NAME`` makes an API key (``service.guard.key_file``)."""

from __future__ import annotations

import argparse
import json
import secrets
import sys

from service.guard.key_file import NAME, key_digest


def main() -> int:
    parser = argparse.ArgumentParser(
        description="Makes an API key. Prints the key on standard error, and on standard output its entry for "
        "DRAPE_KEYS_FILE, which holds only a hash."
    )
    parser.add_argument("name", help="the name of the key's owner: at most 40 small letters, digits and dashes")
    name = parser.parse_args().name
    if not NAME.fullmatch(name):
        print("service.keys: NAME: expected at most 40 small letters, digits and dashes.", file=sys.stderr)
        return 2
    key = f"drape_{secrets.token_urlsafe(32)}"
    print(f"The key, shown once: {key}", file=sys.stderr)
    print(json.dumps({name: {"sha256": key_digest(key)}}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
