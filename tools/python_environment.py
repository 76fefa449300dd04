"""A Python environment for the scripts beside this file, made under target/ on first use."""
import os
import subprocess
import sys
import venv

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
PACKAGES = ["laspy==2.7.0", "lazrs==0.8.2", "copclib==2.6.3", "numpy"]


def enter(name="python", more=()):
    """Runs the calling script again inside the environment of that name, with those packages more,
    unless it already does."""
    folder = os.path.join(ROOT, "target", name)
    python = os.path.join(folder, "bin", "python")
    if os.path.abspath(sys.prefix) == folder:
        return
    ready = os.path.join(folder, "ready")
    if not os.path.exists(ready):
        print("setting up", folder, file=sys.stderr)
        venv.create(folder, with_pip=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", *PACKAGES, *more], check=True)
        open(ready, "w").close()
    script = os.path.abspath(sys.argv[0])
    os.execv(python, [python, script, *sys.argv[1:]])
