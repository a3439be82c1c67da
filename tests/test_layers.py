"""Who may import whom. Imports are read from the source, so that nothing has to be built or run."""

import ast
import re
import sys
from pathlib import Path

TOP = Path(__file__).resolve().parents[1]
SOURCE = TOP / "runtime" / "src"
STAGES = ("tools", "traces", "eval")
# Only these files of the package root know the stages.
KNOW_ALL = (
    *(
        "cli_make",
        "cli_trace",
        "cli_judge",
        "cli_check",
        "check_case",
        "tally",
        "calibrate",
        "importing",
        "recording",
        "demo",
        "check",
        "golden",
    ),
    *("chart", "chart_inputs", "compare", "paper"),
    *("lean", "tune", "tune_beyond", "tune_cells", "tune_search", "cli_tune"),
)
# An include goes to an earlier row only, or to the file's own header.
LAYERS = [
    "utf8 trig",
    "error records algebra crc32 cdr mcap wide parallel",
    "random triangle_tree point_tree sphere_tree hand schemas mcap_reader mcap_writer",
    "bound_tree inside_ball sphere_union object gap qp pack_file resample channels",
    "contacts cover_fit curvature device_recording metric trace_file run_file",
    "cover_moves force filter recorder release search",
    "solver",
    "baseline round",
    "bend solve_.*",
    "settings session",
    "replay",
    "c_api python.*",
]
# Any other package has these doors only. OF_FUNCTIONS are too heavy for the top of a file.
EVERYWHERE = {"palmar", "numpy", "scipy"}
DOORS = {
    "igl": ["eval/gap.py", "tools/close.py", "tools/moved.py", "tools/solid.py"],
    "manifold3d": ["tools/close.py", "tools/hand_palm.py", "tools/lattice.py", "tools/shapes.py"],
    "open3d": ["tools/scan.py"],
    "OpenEXR": ["runtime/palmar/exr.py"],
    "matplotlib": [
        "eval/chart_figures.py",
        "eval/figures.py",
        "eval/maps.py",
        "eval/paper_figures.py",
        "eval/paper_page.py",
        "tools/cover_picture.py",
        "tools/hand_picture.py",
    ],
    "plotly": ["eval/page.py"],
    "flatbuffers": ["traces/isaac_teleop.py"],
    "mcap": ["traces/isaac_teleop.py"],
    "pyarrow": ["runtime/palmar/tables.py"],
    "pydantic": ["traces/column_map.py", "traces/scene_file.py"],
    "pygltflib": ["tools/gltf_skin.py"],
    "rich": ["runtime/palmar/terminal.py"],
    "safetensors": ["runtime/palmar/model.py"],
    "serial": ["traces/port.py"],
    "threadpoolctl": ["tools/hand_fit.py", "traces/finger_shape.py", "traces/inverse.py"],
    "trimesh": [
        "eval/picture.py",
        "eval/view3d.py",
        *(f"tools/{name}.py" for name in ("close", "mesh", "moved", "painted")),
    ],
    "typer": [
        f"runtime/palmar/cli{name}.py"
        for name in ("", "_app", "_calibrate", "_make", "_record", "_trace", "_judge", "_check", "_chart", "_tune")
    ],
}
OF_FUNCTIONS = {"open3d", "pyarrow", "pyvista"}


def imports(path: Path) -> set[tuple[str, bool]]:
    """(module, whether at the top of the file) of every import of a Python file."""
    tree = ast.parse(path.read_text())
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {(alias.name, node in tree.body) for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import"
            found |= {(f"{node.module}.{alias.name}", node in tree.body) for alias in node.names}
    return found


def python_files() -> list[Path]:
    return [path for folder in (*STAGES, "runtime/palmar") for path in sorted((TOP / folder).glob("*.py"))]


def test_stages_do_not_know_each_other_and_only_the_command_line_knows_them():
    for path in python_files():
        stage = path.parent.name
        known = {name.split(".")[1] for name, _ in imports(path) if name.startswith("palmar.")} & set(STAGES)
        allowed = set(STAGES) if stage == "palmar" and path.stem in KNOW_ALL else {stage}
        assert known <= allowed, f"{path} imports {known - allowed}"


def test_the_judges_share_nothing_with_the_solver():
    for path in (TOP / "eval").glob("*.py"):
        assert not any(name.startswith("palmar._runtime") for name, _ in imports(path)), path


def test_third_party_packages_have_few_doors():
    for path in python_files():
        place = path.relative_to(TOP).as_posix()
        for name, at_top in imports(path):
            package = name.split(".")[0]
            assert package not in OF_FUNCTIONS or not at_top, f"{place} imports {package} at its top"
            if package not in sys.stdlib_module_names | EVERYWHERE:
                assert place in DOORS.get(package, []), f"{place} is no door for {package}"


def test_includes_of_the_core_go_down_only():
    def layer(stem: str) -> int:
        found = [k for k, row in enumerate(LAYERS) if any(re.fullmatch(name, stem) for name in row.split())]
        assert len(found) == 1, f"{stem} stands in {len(found)} rows of LAYERS"
        return found[0]

    for path in SOURCE.iterdir():
        for name in re.findall(r'^#include "(\w+)\.h"', path.read_text(), re.M):
            assert name == path.stem or layer(name) < layer(path.stem), f"{path.name} includes {name}.h"
