"""Install the wheel of a folder into a scratch environment and use it there.

The environment sees this interpreter's packages, so that nothing is downloaded; geraf2 itself
must come from the wheel, which is checked by where it was imported from.
"""

import subprocess
import sys
import sysconfig
import tempfile
import venv
from pathlib import Path

PROBE = """
import pathlib, sys
import geraf2
from geraf2 import _core
folder = pathlib.Path(geraf2.__file__).resolve().parent
scratch = pathlib.Path(sys.argv[1]).resolve()
assert folder.is_relative_to(scratch), f"imported from {folder}, not from the wheel"
assert (folder / "py.typed").is_file() and (folder / "_core.pyi").is_file()
report = folder / "report"
assert (report / "templates" / "run.html").is_file() and (report / "viewer" / "viewer.js").is_file()
assert (folder / "surfaces" / "completion.safetensors").is_file()
assert (folder / "echoes" / "faces.safetensors").is_file()
print(f"geraf2 {geraf2.__version__} from the wheel, Embree {_core.embree_major()}")
"""


def main(dist: str) -> None:
    wheels = sorted(Path(dist).glob("*.whl"))
    if len(wheels) != 1:
        sys.exit(f"{dist}: expected one wheel, got {len(wheels)}")
    with tempfile.TemporaryDirectory() as scratch:
        venv.create(scratch, with_pip=False)
        python = Path(scratch) / "bin" / "python"
        site = next((Path(scratch) / "lib").glob("python*/site-packages"))
        pip = [sys.executable, "-m", "pip", "--python", str(python)]
        install = ["install", "--quiet", "--no-deps", "--no-index", str(wheels[0])]
        subprocess.run([*pip, *install], check=True)
        # Dependencies come from here. Appended as a .pth line, the folder's packages are seen,
        # but a plain path does not run its .pth files, so the editable geraf2 stays out.
        (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
        subprocess.run(
            [str(python), "-c", PROBE, scratch], check=True, cwd=scratch, env={"PATH": ""}
        )


if __name__ == "__main__":
    main(sys.argv[1])
