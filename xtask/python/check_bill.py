"""Checks a bill of materials against the CycloneDX 1.6 schema, and that each component has a licence; `cargo xtask release` runs this."""

import json
import sys
from pathlib import Path

from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator


def main() -> None:
    """Exits with a message if the bill is wrong."""
    file = Path(sys.argv[1])
    text = file.read_text(encoding="utf-8")
    problem = JsonStrictValidator(SchemaVersion.V1_6).validate_str(text)
    if problem is not None:
        sys.exit(f"{file} is no bill of CycloneDX 1.6: {str(problem).splitlines()[0]}")
    components = json.loads(text)["components"]
    bare = [component["purl"] for component in components if not component.get("licenses")]
    if bare:
        sys.exit(f"{file} names no licence of {', '.join(bare)}")
    print(f"{file.name}: {len(components)} components, each with its licence, valid by the schema of CycloneDX 1.6")


if __name__ == "__main__":
    main()
