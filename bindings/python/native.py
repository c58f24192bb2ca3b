"""The C ABI of sketch2pq, one to one: include/sketch2pq.h in ctypes. For an idiomatic interface see sketch2pq.py."""

import ctypes as c
import os
import sys
from pathlib import Path

ABI_VERSION = 1

OK, INVALID_ARGUMENT, INVALID_SKETCH, INVALID_GEOMETRY, NOT_REACHED, CANCELLED, UNAVAILABLE, INTERNAL = range(8)
VISIBLE_BOUNDARY, OCCLUDED_BOUNDARY, CONTOUR, FEATURE = range(4)
VISIBLE, OCCLUDED = range(2)
BACKEND_AUTO, BACKEND_ORT, BACKEND_EMBEDDED = range(3)
BORDER_TRIMMED, BORDER_ALIGNED, BORDER_INTERIOR = range(3)
HOLD_SLIDE, HOLD_PINNED, HOLD_FREE = range(3)
OFFSETS_ANY, OFFSETS_CIRCULAR, OFFSETS_CONICAL = range(3)

_u32, _u64, _f64, _size, _text, _handle = c.c_uint32, c.c_uint64, c.c_double, c.c_size_t, c.c_char_p, c.c_void_p
_f64s, _u32s, _i32s, _u8s = c.POINTER(c.c_double), c.POINTER(c.c_uint32), c.POINTER(c.c_int32), c.POINTER(c.c_uint8)


class SessionOptions(c.Structure):
    """S2pqSessionOptions"""

    _fields_ = [
        ("struct_size", _u32),
        ("backend", _u32),
        ("threads", _u32),
        ("live", _u32),
        ("runtime_path", _text),
        ("models_folder", _text),
    ]


class SurfaceOptions(c.Structure):
    """S2pqSurfaceOptions"""

    _fields_ = [("struct_size", _u32), ("reserved", _u32), ("corners", _f64s), ("fairness", _f64)]


class Nurbs(c.Structure):
    """S2pqNurbs"""

    _fields_ = [
        ("struct_size", _u32),
        ("degree_u", _u32),
        ("degree_v", _u32),
        ("reserved", _u32),
        ("count_u", _u64),
        ("count_v", _u64),
        ("knot_count_u", _u64),
        ("knot_count_v", _u64),
        ("knots_u", _f64s),
        ("knots_v", _f64s),
        ("control_points", _f64s),
        ("weights", _f64s),
    ]


class SurfaceDiagnostics(c.Structure):
    """S2pqSurfaceDiagnostics"""

    _fields_ = [
        ("struct_size", _u32),
        ("fold_overs", _u32),
        ("reprojection_mean_px", _f64),
        ("reprojection_max_px", _f64),
        ("sample_residual", _f64),
        ("misfacing", _f64),
        ("warm_start", _u32),
        ("reserved", _u32),
    ]


class Singularities(c.Structure):
    """S2pqSingularities"""

    _fields_ = [
        ("struct_size", _u32),
        ("reserved", _u32),
        ("count", _u64),
        ("points", _f64s),
        ("parameters", _f64s),
        ("patches", _u32s),
        ("indices", _i32s),
    ]


class FieldOptions(c.Structure):
    """S2pqFieldOptions"""

    _fields_ = [
        ("struct_size", _u32),
        ("use_network", _u32),
        ("align_border", _u32),
        ("resolution", _u32),
        ("crossing_floor_deg", _f64),
        ("singularities", c.POINTER(Singularities)),
        ("edge_length", _f64),
        ("faces", _u32),
        ("reserved", _u32),
    ]


class Curves(c.Structure):
    """S2pqCurves"""

    _fields_ = [
        ("struct_size", _u32),
        ("reserved", _u32),
        ("curve_count", _u64),
        ("starts", _u32s),
        ("points", _f64s),
        ("hard", _u8s),
    ]


class FieldDiagnostics(c.Structure):
    """S2pqFieldDiagnostics"""

    _fields_ = [
        ("struct_size", _u32),
        ("singularities", _u32),
        ("conjugacy_mean", _f64),
        ("conjugacy_max", _f64),
        ("crossing_min_deg", _f64),
        ("feature_angle_deg", _f64),
    ]


class MeshOptions(c.Structure):
    """S2pqMeshOptions"""

    _fields_ = [
        ("struct_size", _u32),
        ("border", _u32),
        ("faces", _u32),
        ("strict", _u32),
        ("edge_length", _f64),
        ("planarity", _f64),
        ("offsets", _u32),
        ("hold", _u32),
    ]


class Polygons(c.Structure):
    """S2pqPolygons"""

    _fields_ = [
        ("struct_size", _u32),
        ("reserved", _u32),
        ("vertex_count", _u64),
        ("face_count", _u64),
        ("pin_count", _u64),
        ("vertices", _f64s),
        ("starts", _u32s),
        ("indices", _u32s),
        ("pins", _u32s),
    ]


class PlanarizeOptions(c.Structure):
    """S2pqPlanarizeOptions"""

    _fields_ = [
        ("struct_size", _u32),
        ("offsets", _u32),
        ("hold", _u32),
        ("strict", _u32),
        ("planarity", _f64),
        ("deviation", _f64),
        ("closeness", _f64),
        ("fairness", _f64),
        ("anchor", _f64),
    ]


class MeshReport(c.Structure):
    """S2pqMeshReport"""

    _fields_ = [
        ("struct_size", _u32),
        ("faces", _u32),
        ("quads", _u32),
        ("irregular_vertices", _u32),
        ("planarity_max", _f64),
        ("planarity_mean", _f64),
        ("deviation_max", _f64),
        ("deviation_max_edges", _f64),
        ("edge_length_mean", _f64),
        ("border_covered", _f64),
        ("time_ms", _f64),
        ("deviation_over_limit", _f64),
        ("border_deviation_widths", _f64),
    ]


#: Size and offsets that the header's structs have where pointers are 64 bits wide; checked on load.
LAYOUT = {
    SessionOptions: (32, [0, 4, 8, 12, 16, 24]),
    SurfaceOptions: (24, [0, 4, 8, 16]),
    Nurbs: (80, [0, 4, 8, 12, 16, 24, 32, 40, 48, 56, 64, 72]),
    SurfaceDiagnostics: (48, [0, 4, 8, 16, 24, 32, 40, 44]),
    Singularities: (48, [0, 4, 8, 16, 24, 32, 40]),
    FieldOptions: (48, [0, 4, 8, 12, 16, 24, 32, 40, 44]),
    Curves: (40, [0, 4, 8, 16, 24, 32]),
    FieldDiagnostics: (40, [0, 4, 8, 16, 24, 32]),
    MeshOptions: (40, [0, 4, 8, 12, 16, 24, 32, 36]),
    Polygons: (64, [0, 4, 8, 16, 24, 32, 40, 48, 56]),
    PlanarizeOptions: (56, [0, 4, 8, 12, 16, 24, 32, 40, 48]),
    MeshReport: (88, [0, 4, 8, 12, 16, 24, 32, 40, 48, 56, 64, 72, 80]),
}

#: void (*S2pqProgress)(void *user, const char *stage, double fraction)
Progress = c.CFUNCTYPE(None, c.c_void_p, c.c_char_p, c.c_double)

_out = c.POINTER

#: Every export: result, then arguments. A progress callback is passed as a plain pointer, so that None is NULL.
SIGNATURES = {
    "s2pq_abi_version": (_u32, []),
    "s2pq_version": (_text, []),
    "s2pq_last_message": (_size, [c.c_char_p, _size]),
    "s2pq_status_name": (_text, [_u32]),
    "s2pq_session_options_init": (_u32, [_out(SessionOptions), _size]),
    "s2pq_session_new": (_u32, [_out(SessionOptions), _out(_handle)]),
    "s2pq_session_set_progress": (_u32, [_handle, c.c_void_p, c.c_void_p]),
    "s2pq_session_backend": (_u32, [_handle, _out(_text)]),
    "s2pq_cancel": (_u32, [_handle]),
    "s2pq_cancel_reset": (_u32, [_handle]),
    "s2pq_session_free": (None, [_handle]),
    "s2pq_sketch_new": (_u32, [_out(_handle)]),
    "s2pq_sketch_from_json": (_u32, [c.c_char_p, _size, _out(_handle)]),
    "s2pq_sketch_from_svg": (_u32, [c.c_char_p, _size, _out(_handle)]),
    "s2pq_sketch_set_view_angles": (_u32, [_handle, _f64, _f64, _u32]),
    "s2pq_sketch_set_view_axes": (_u32, [_handle, _f64s, _u32]),
    "s2pq_sketch_add_stroke": (_u32, [_handle, _u32, _f64s, _size]),
    "s2pq_sketch_add_depth_sample": (_u32, [_handle, _u32, _f64, _f64, _f64]),
    "s2pq_sketch_clear": (_u32, [_handle]),
    "s2pq_sketch_counts": (_u32, [_handle, _out(_size), _out(_size)]),
    "s2pq_sketch_free": (None, [_handle]),
    "s2pq_surface_options_init": (_u32, [_out(SurfaceOptions), _size]),
    "sketch_to_surface": (_u32, [_handle, _handle, _out(SurfaceOptions), _out(_handle)]),
    "s2pq_surface_from_nurbs": (_u32, [_out(Nurbs), _out(_handle)]),
    "s2pq_surface_add_nurbs": (_u32, [_handle, _out(Nurbs)]),
    "s2pq_surface_patch_count": (_u32, [_handle, _out(_size)]),
    "s2pq_surface_nurbs": (_u32, [_handle, _size, _out(Nurbs)]),
    "s2pq_surface_evaluate": (_u32, [_handle, _size, _f64s, _size, _f64s, _f64s]),
    "s2pq_surface_bezier": (_u32, [_handle, _size, _out(_f64s), _out(_size), _out(_size)]),
    "s2pq_surface_grid": (_u32, [_handle, _size, _size, _size, _f64s, _f64s, _u32s]),
    "s2pq_surface_diagnostics": (_u32, [_handle, _size, _out(SurfaceDiagnostics)]),
    "s2pq_surface_unused_strokes": (_u32, [_handle, _out(_u32s), _out(_size)]),
    "s2pq_surface_report_json": (_u32, [_handle, _out(_text), _out(_size)]),
    "s2pq_surface_free": (None, [_handle]),
    "s2pq_field_options_init": (_u32, [_out(FieldOptions), _size]),
    "sketch_to_cdf": (_u32, [_handle, _handle, _handle, _out(FieldOptions), _out(_handle)]),
    "surface_to_cdf": (_u32, [_handle, _handle, _out(Curves), _out(FieldOptions), _out(_handle)]),
    "s2pq_field_patches": (_u32, [_handle, _out(_u32s), _out(_u32s), _out(_size)]),
    "s2pq_field_vertices": (_u32, [_handle, _out(_f64s), _out(_size)]),
    "s2pq_field_triangles": (_u32, [_handle, _out(_u32s), _out(_size)]),
    "s2pq_field_directions": (_u32, [_handle, _out(_f64s), _out(_size)]),
    "s2pq_field_singularities": (_u32, [_handle, _out(_u32s), _out(_i32s), _out(_size)]),
    "s2pq_field_floor_triangles": (_u32, [_handle, _out(_u32s), _out(_size)]),
    "s2pq_field_diagnostics": (_u32, [_handle, _out(FieldDiagnostics)]),
    "s2pq_field_report_json": (_u32, [_handle, _out(_text), _out(_size)]),
    "s2pq_field_free": (None, [_handle]),
    "s2pq_mesh_options_init": (_u32, [_out(MeshOptions), _size]),
    "extract_pq_mesh": (_u32, [_handle, _handle, _out(MeshOptions), _out(_handle)]),
    "s2pq_planarize_options_init": (_u32, [_out(PlanarizeOptions), _size]),
    "s2pq_planarize": (_u32, [_handle, _out(Polygons), _handle, _out(PlanarizeOptions), _out(_handle)]),
    "s2pq_mesh_patches": (_u32, [_handle, _out(_u32s), _out(_u32s), _out(_size)]),
    "s2pq_mesh_vertices": (_u32, [_handle, _out(_f64s), _out(_size)]),
    "s2pq_mesh_faces": (_u32, [_handle, _out(_u32s), _out(_u32s), _out(_size)]),
    "s2pq_mesh_planarity": (_u32, [_handle, _out(_f64s), _out(_size)]),
    "s2pq_mesh_deviation": (_u32, [_handle, _out(_f64s), _out(_size)]),
    "s2pq_mesh_border": (_u32, [_handle, _out(_u8s), _out(_size)]),
    "s2pq_mesh_irregular_vertices": (_u32, [_handle, _out(_u32s), _out(_size)]),
    "s2pq_mesh_report": (_u32, [_handle, _out(MeshReport)]),
    "s2pq_mesh_obj": (_u32, [_handle, _out(_text), _out(_size)]),
    "s2pq_mesh_report_json": (_u32, [_handle, _out(_text), _out(_size)]),
    "s2pq_mesh_free": (None, [_handle]),
}


def library_path():
    """Where the shared library is: SKETCH2PQ_LIBRARY (a file), beside this file, or the newer build of the repository."""
    names = {"win32": "sketch2pq.dll", "darwin": "libsketch2pq.dylib"}
    name = names.get(sys.platform, "libsketch2pq.so")
    if named := os.environ.get("SKETCH2PQ_LIBRARY"):
        return Path(named)
    here = Path(__file__).resolve().parent
    if (here / name).exists():
        return here / name
    builds = [here.parents[1] / "target" / profile / name for profile in ("release", "debug")]
    found = [path for path in builds if path.exists()]
    if not found:
        raise OSError(f"{name} is neither beside {here} nor in {builds[0].parent}: build it with cargo build --release")
    return max(found, key=lambda path: path.stat().st_mtime)


def load(path=None):
    """Loads the library, checks its ABI version and the layout of the structs, and declares every export."""
    for struct, (size, offsets) in LAYOUT.items():
        actual = [getattr(struct, name).offset for name, _ in struct._fields_]
        if c.sizeof(c.c_void_p) == 8 and (c.sizeof(struct), actual) != (size, offsets):
            raise ImportError(f"{struct.__name__} has size {c.sizeof(struct)} and offsets {actual}")
    library = c.CDLL(str(path or library_path()))
    library.s2pq_abi_version.restype = _u32
    version = library.s2pq_abi_version()
    if version != ABI_VERSION:
        raise ImportError(f"the library has ABI version {version}, this binding {ABI_VERSION}")
    for name, (result, arguments) in SIGNATURES.items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return library
