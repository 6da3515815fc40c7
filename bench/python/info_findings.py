"""What `geraf2 info` warns of before a scan is processed, by the kind of scan.

    python bench/python/verdict_scans.py --out DIR --set estimate
    python bench/python/info_findings.py DIR

DIR holds good and bad scans, NAME.json beside each scene NAME, whose key `kind` says what it is.
One line is printed for each kind: scans, and how many of them have each finding.
"""

import argparse
import json
from collections import Counter, defaultdict
from pathlib import Path

from geraf2.freespace.coverage import summary_coverage
from geraf2.io.container import is_scene
from geraf2.scene import load_capture
from geraf2.scene.checks import check_capture
from geraf2.scene.summary import summarize_capture

FINDINGS = {
    "saturated": "look saturated",
    "no signal": "signal is constant",
    "same samples": "hold the same samples",
    "other ranges": "nearer or farther than those of the others",
    "empty box": "the box is empty or not there",
    "echoes outside the box": "outside the ranges of the stated box",
    "other level": "dB off the median",
    "heights out of sight": "send no echo back, only",
    "heights between": "lies between the antennas",
    "a side without planes": "no antenna looks at the content",
    "few normals": "most of a surface would be guessed",
    "grating lobes": "expect grating lobes",
    "offset": "constant offset (DC)",
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path)
    scans, found = Counter[str](), defaultdict[str, Counter[str]](Counter)
    for scene in sorted(parser.parse_args().folder.iterdir()):
        record = scene.with_name(f"{scene.name}.json")
        if not is_scene(scene) or not record.is_file():
            continue
        kind = json.loads(record.read_text())["kind"]
        summary = summarize_capture(load_capture(scene))
        coverage = summary_coverage(summary)
        findings = [*check_capture(summary), *(coverage.findings() if coverage else ())]
        scans[kind] += 1
        found[kind].update(
            name for name, words in FINDINGS.items() if any(words in str(f) for f in findings)
        )
    for kind, n in sorted(scans.items()):
        each = ", ".join(f"{name} {count}" for name, count in found[kind].most_common())
        print(f"{kind:<24} {n:>3} scans: {each or 'nothing'}")


if __name__ == "__main__":
    main()
