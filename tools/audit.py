"""Known vulnerabilities of what is installed, by pip-audit: `make audit`.

Fails where one is known, and where the registry knows of no package at all: nothing was checked.
"""

import json
import subprocess
import sys


def main():
    command = [sys.executable, "-m", "pip_audit", "--progress-spinner", "off", "--skip-editable"]
    done = subprocess.run([*command, "--format", "json"], check=False, capture_output=True)
    try:
        packages = json.loads(done.stdout)["dependencies"]
    except ValueError:
        sys.exit(done.stderr.decode(errors="replace"))
    checked = [package for package in packages if "vulns" in package]
    found = [(package, hole) for package in checked for hole in package["vulns"]]
    for package, hole in found:
        fixed = ", ".join(hole["fix_versions"]) or "no version"
        print(f"{package['name']} {package['version']}: {hole['id']}, mended in {fixed}")
    print(f"{len(checked)} of {len(packages)} packages checked, {len(found)} vulnerabilities")
    if not checked:
        print("the registry has no advisories: run it where pypi.org/pypi answers", file=sys.stderr)
    return int(bool(found) or not checked)


if __name__ == "__main__":
    sys.exit(main())
