"""A sketch in, counts out: the three calls. `cargo build --release` first; needs NumPy.

    python examples/sketch_to_panels.py [SKETCH.json]
"""

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "bindings" / "python"))

from sketch2pq import Session, Sketch  # noqa: E402


def main():
    path = sys.argv[1] if len(sys.argv) > 1 else ROOT / "examples" / "sketches" / "rounded_corner.json"
    session = Session(progress=lambda stage, fraction: print(f"\r{stage} {fraction:4.0%} ", end="", file=sys.stderr))
    sketch = Sketch.read(path)
    surface = session.surface(sketch)
    field = session.field(surface, sketch)
    mesh = session.mesh(field)
    print(f"\n{len(mesh.faces)} faces, {mesh.measures['quads']} of them quads, planar to {mesh.planarity.max():.1e}")


if __name__ == "__main__":
    main()
