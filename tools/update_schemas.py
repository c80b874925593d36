"""Write the shipped message definitions anew from the installed message packages.

Run it with the Python that has this package and ROS 2 Jazzy (an installation that is sourced, or
the wheels): ``python tools/update_schemas.py``. Look at ``git diff`` afterwards: a changed hash
means that bags recorded before and after hold different types under the same name.
"""

from __future__ import annotations

import json
from pathlib import Path

from quad_mpc_ros.messages import schemas

FOLDER = Path(schemas.__file__).parent / "schemas"


def main() -> None:
    """Write every shipped schema and the hashes into the source tree."""
    FOLDER.mkdir(exist_ok=True)
    hashes = {}
    for type_name in schemas.SHIPPED_TYPES:
        schema = schemas.installed_schema(type_name)
        path = FOLDER / schemas.shipped_file_name(type_name)
        path.write_bytes(schema.text.encode())
        hashes[type_name] = schema.type_hash
        print(f"{type_name} {schema.type_hash}")
    (FOLDER / schemas.HASHES_FILE).write_text(json.dumps(hashes, indent=2) + "\n")


if __name__ == "__main__":
    main()
