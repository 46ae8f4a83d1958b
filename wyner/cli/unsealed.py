"""``wyner unsealed``: the sealed messages that a plant has opened."""

import argparse
import base64
import json
from pathlib import Path

from protocol.text import readable
from runtime.errors import DONE, UsageError, reading
from runtime.run_folder import PLANT_KEYS


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = "Show what came by `wyner send --sealed`, in order: identifier and text."
    parser.add_argument("run_dir", type=Path, metavar="RUN_DIR", help="the plant's run folder")
    parser.add_argument("--json", action="store_true", help="one JSON array, payloads in base64")


def run(args: argparse.Namespace) -> int:
    """Read the store."""
    from protocol.secret.records import StoreError
    from runtime.keys.sealed_book import SealedBook
    from runtime.keys.store import KeyStore

    try:
        path = args.run_dir / PLANT_KEYS
        with reading(str(path)), KeyStore(path, "plant") as store:
            opened = SealedBook(store).opened()
    except StoreError as error:
        raise UsageError(str(error)) from None
    if args.json:
        print(json.dumps([{"id": i, "payload": base64.b64encode(p).decode()} for i, p in opened]))
    else:
        for identifier, payload in opened:
            print(f"{identifier}  {readable(payload)}")
    return DONE
