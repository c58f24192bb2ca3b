"""An architect's sketch in, a NURBS surface and a mesh of planar quads out.

    from sketch2pq import Session, Sketch

    session = Session()
    sketch = Sketch()
    sketch.add_stroke("visible_boundary", [(30, 190), (130, 222), (228, 192), ...])
    surface = session.surface(sketch)
    field = session.field(surface, sketch)
    mesh = session.mesh(field, faces=300)
    mesh.vertices, mesh.faces, mesh.planarity

Needs NumPy and the shared library, see native.library_path. World frame: right-handed, z up, in the canvas' unit. Arrays of results are read-only
views into the library's memory, and keep it alive. One thread at a time for each object; Session.cancel works from any thread.
"""

import ctypes
import json
from pathlib import Path

import numpy as np

try:
    from . import native
except ImportError:
    import native

_library = None

STROKE_KINDS = {"visible_boundary": 0, "occluded_boundary": 1, "contour": 2, "feature": 3}
LAYERS = {"visible": 0, "occluded": 1}
BACKENDS = {"auto": 0, "ort": 1, "embedded": 2}
SIDES = {"u_min": 2, "u_max": 4, "v_min": 8, "v_max": 16}
BORDERS = {"trimmed": 0, "aligned": 1, "interior": 2}
HOLDS = {"slide": 0, "pinned": 1, "free": 2}
OFFSETS = {"any": 0, "circular": 1, "conical": 2}


class Error(Exception):
    """A call failed: `status` is a number of the ABI, `message` says what happened and where."""

    def __init__(self, status, message):
        super().__init__(message)
        self.status = status
        self.message = message


class SketchError(Error):
    """The sketch is empty, open, or contradicts itself: change the drawing where the message says."""


class GeometryError(Error):
    """The surface, field or mesh is degenerate."""


class NotReached(Error):
    """A target could not be reached: relax it."""


class Cancelled(Error):
    """Session.cancel was called."""


class Unavailable(Error):
    """A file, a model or the backend cannot be used."""


class InternalError(Error):
    """A defect of the library: report it."""


class ArgumentError(Error, ValueError):
    """An argument is outside its range."""


_ERRORS = {
    native.INVALID_ARGUMENT: ArgumentError,
    native.INVALID_SKETCH: SketchError,
    native.INVALID_GEOMETRY: GeometryError,
    native.NOT_REACHED: NotReached,
    native.CANCELLED: Cancelled,
    native.UNAVAILABLE: Unavailable,
    native.INTERNAL: InternalError,
}


def library():
    """The loaded library; the first call loads it."""
    global _library
    if _library is None:
        _library = native.load()
    return _library


def version():
    """Version of the library, "major.minor.patch"."""
    return library().s2pq_version().decode()


def _check(status):
    if status != native.OK:
        length = library().s2pq_last_message(None, 0)
        buffer = ctypes.create_string_buffer(length + 1)
        library().s2pq_last_message(buffer, length + 1)
        raise _ERRORS.get(status, Error)(status, buffer.value.decode())


def _number(names, name, what):
    if name not in names:
        raise ArgumentError(native.INVALID_ARGUMENT, f"{what} is {name!r}, expected one of {', '.join(names)}")
    return names[name]


def _sides(aligned):
    if isinstance(aligned, (bool, np.bool_)):
        return int(aligned)
    return sum({_number(SIDES, side, "align_border") for side in aligned})


def _doubles(values, columns, what):
    try:
        array = np.ascontiguousarray(values, dtype=np.float64).reshape(-1, columns)
    except (TypeError, ValueError):
        raise ArgumentError(native.INVALID_ARGUMENT, f"{what}: expected rows of {columns} numbers") from None
    return array, array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


def _indices(values, what):
    array = np.asarray(values)
    if array.size == 0:
        return np.empty(0, np.uint32)
    if array.ndim != 1 or array.dtype.kind not in "iu" or array.min() < 0 or array.max() >= 2**32:
        raise ArgumentError(native.INVALID_ARGUMENT, f"{what}: expected rows of vertex numbers")
    return np.ascontiguousarray(array, dtype=np.uint32)


def _singularities(rows):
    """The struct, and the arrays that it points into."""
    try:
        rows = [(tuple(place), index, *patch) for place, index, *patch in rows]
        columns = {len(place) for place, *_ in rows} or {3}
        indices = np.array([row[1] for row in rows], dtype=np.int32)
        exact = all(index == row[1] for index, row in zip(indices, rows))
    except (TypeError, ValueError, OverflowError):
        columns, exact = set(), False
    if not exact or columns not in ({2}, {3}):
        expected = "expected ((x, y, z), index) each, or ((u, v), index) and perhaps the patch"
        raise ArgumentError(native.INVALID_ARGUMENT, f"singularities: {expected}")
    (width,) = columns
    places, pointer = _doubles([row[0] for row in rows], width, "singularities")
    patches = _indices([row[2] if len(row) > 2 else 0 for row in rows], "singularities")
    given = native.Singularities(
        struct_size=ctypes.sizeof(native.Singularities),
        count=len(rows),
        indices=indices.ctypes.data_as(ctypes.POINTER(ctypes.c_int32)),
        patches=patches.ctypes.data_as(ctypes.POINTER(ctypes.c_uint32)),
    )
    setattr(given, "points" if width == 3 else "parameters", pointer)
    return given, (places, indices, patches)


class _Handle:
    """An object of the library, freed with its last reference; views of results hold one."""

    _free = None

    def __init__(self, pointer):
        self._pointer = pointer

    def __del__(self):
        if getattr(self, "_pointer", None) and _library is not None:
            getattr(_library, self._free)(self._pointer)
            self._pointer = None

    def _view(self, pointer, count, columns=None):
        """A read-only array over `count` (times `columns`) values that the library lends."""
        shape = (count,) if columns is None else (count, columns)
        if count == 0:
            return np.empty(shape, dtype=np.dtype(pointer._type_))
        size = count * (columns or 1)
        buffer = (pointer._type_ * size).from_address(ctypes.addressof(pointer.contents))
        buffer._owner = self
        array = np.frombuffer(buffer, dtype=np.dtype(pointer._type_)).reshape(shape)
        array.flags.writeable = False
        return array

    def _array(self, export, value_type, columns=None):
        pointer, count = ctypes.POINTER(value_type)(), ctypes.c_size_t()
        _check(getattr(library(), export)(self._pointer, ctypes.byref(pointer), ctypes.byref(count)))
        return self._view(pointer, count.value, columns)

    def _string(self, export):
        text = ctypes.c_char_p()
        _check(getattr(library(), export)(self._pointer, ctypes.byref(text), None))
        return text.value.decode()

    def _struct(self, export, struct, *arguments):
        value = struct(struct_size=ctypes.sizeof(struct))
        _check(getattr(library(), export)(self._pointer, *arguments, ctypes.byref(value)))
        return value


def _measures(struct):
    return {name: getattr(struct, name) for name, _ in struct._fields_ if name not in ("struct_size", "reserved")}


def _options(struct, init, **values):
    options = struct()
    _check(getattr(library(), init)(ctypes.byref(options), ctypes.sizeof(struct)))
    for name, value in values.items():
        if value is None:
            continue
        try:
            setattr(options, name, value)
        except TypeError:
            raise ArgumentError(native.INVALID_ARGUMENT, f"{name} is {value!r}") from None
        if isinstance(value, int) and getattr(options, name) != value:
            raise ArgumentError(native.INVALID_ARGUMENT, f"{name} is {value}, expected a small non-negative number")
    return options


class Sketch(_Handle):
    """Strokes and depth samples on a canvas, and the view."""

    _free = "s2pq_sketch_free"

    def __init__(self, azimuth_deg=45.0, elevation_deg=45.0, y_down=True):
        pointer = ctypes.c_void_p()
        _check(library().s2pq_sketch_new(ctypes.byref(pointer)))
        super().__init__(pointer)
        self.set_view(azimuth_deg, elevation_deg, y_down)

    @classmethod
    def from_json(cls, text):
        """A sketch from JSON text, the form of the files in examples/sketches."""
        return cls._from_text(library().s2pq_sketch_from_json, text)

    @classmethod
    def from_svg(cls, text):
        """A sketch from SVG text: the names of layers, else the colours, tell what a stroke is; see the C header."""
        return cls._from_text(library().s2pq_sketch_from_svg, text)

    @classmethod
    def _from_text(cls, parse, text):
        data = text.encode() if isinstance(text, str) else bytes(text)
        pointer = ctypes.c_void_p()
        _check(parse(data, len(data), ctypes.byref(pointer)))
        sketch = cls.__new__(cls)
        _Handle.__init__(sketch, pointer)
        return sketch

    @classmethod
    def read(cls, path):
        """A sketch from a JSON file, or from an SVG file if the name ends so."""
        path = Path(path)
        return (cls.from_svg if path.suffix.lower() == ".svg" else cls.from_json)(path.read_bytes())

    def set_view(self, azimuth_deg=45.0, elevation_deg=45.0, y_down=True):
        """Direction towards the viewer: azimuth from world x towards y, elevation above the horizon."""
        _check(library().s2pq_sketch_set_view_angles(self._pointer, azimuth_deg, elevation_deg, int(bool(y_down))))

    def set_view_axes(self, right, up, toward, y_down=True):
        """View by three orthonormal axes in the world: canvas right, canvas up, towards the viewer."""
        _axes, pointer = _doubles([right, up, toward], 3, "view axes")
        _check(library().s2pq_sketch_set_view_axes(self._pointer, pointer, int(bool(y_down))))

    def add_stroke(self, kind, points):
        """Adds a stroke; `kind` is a key of STROKE_KINDS, `points` rows of x, y on the canvas."""
        array, pointer = _doubles(points, 2, "points")
        kind = _number(STROKE_KINDS, kind, "kind")
        _check(library().s2pq_sketch_add_stroke(self._pointer, kind, pointer, len(array)))

    def add_depth_sample(self, layer, x, y, depth):
        """Adds a known depth on a layer, a key of LAYERS; depth grows away from the viewer."""
        layer = _number(LAYERS, layer, "layer")
        _check(library().s2pq_sketch_add_depth_sample(self._pointer, layer, x, y, depth))

    def clear(self):
        """Removes strokes and depth samples; the view stays."""
        _check(library().s2pq_sketch_clear(self._pointer))

    @property
    def counts(self):
        """Number of strokes and of depth samples."""
        strokes, samples = ctypes.c_size_t(), ctypes.c_size_t()
        _check(library().s2pq_sketch_counts(self._pointer, ctypes.byref(strokes), ctypes.byref(samples)))
        return strokes.value, samples.value


class Patch:
    """One NURBS patch of a surface."""

    def __init__(self, surface, index):
        self._surface, self._index = surface, index
        self._nurbs = surface._struct("s2pq_surface_nurbs", native.Nurbs, index)

    @property
    def degrees(self):
        """Degree in u and in v."""
        return self._nurbs.degree_u, self._nurbs.degree_v

    @property
    def control_points(self):
        """(count_u, count_v, 3), world frame."""
        n = self._nurbs
        return self._surface._view(n.control_points, n.count_u * n.count_v, 3).reshape(n.count_u, n.count_v, 3)

    @property
    def weights(self):
        """(count_u, count_v), or None if all are 1."""
        n = self._nurbs
        if not n.weights:
            return None
        return self._surface._view(n.weights, n.count_u * n.count_v).reshape(n.count_u, n.count_v)

    @property
    def knots(self):
        """Knots in u and in v, count + degree + 1 each."""
        n = self._nurbs
        return self._surface._view(n.knots_u, n.knot_count_u), self._surface._view(n.knots_v, n.knot_count_v)

    @property
    def rhino_knots(self):
        """Knots in u and in v as Rhino and openNURBS store them, count + degree - 1 each."""
        u, v = self.knots
        return u[1:-1], v[1:-1]

    def evaluate(self, uv):
        """Points and unit normals at rows of (u, v)."""
        parameters, pointer = _doubles(uv, 2, "uv")
        points, normals = np.empty((len(parameters), 3)), np.empty((len(parameters), 3))
        out = [a.ctypes.data_as(ctypes.POINTER(ctypes.c_double)) for a in (points, normals)]
        _check(
            library().s2pq_surface_evaluate(self._surface._pointer, self._index, pointer, len(parameters), *out)
        )
        return points, normals

    def bezier(self):
        """(pieces_u, pieces_v, 4, 4, 3): control points of the bicubic Bezier patches that the patch consists of.

        GeometryError for a rational patch and for degrees above 3, which no bicubic equals.
        """
        points = ctypes.POINTER(ctypes.c_double)()
        counts = ctypes.c_size_t(), ctypes.c_size_t()
        out = [ctypes.byref(value) for value in (points, *counts)]
        _check(library().s2pq_surface_bezier(self._surface._pointer, self._index, *out))
        u, v = (count.value for count in counts)
        return self._surface._view(points, 16 * u * v, 3).reshape(u, v, 4, 4, 3)

    def grid(self, cells_u, cells_v):
        """Points (V, 3), unit normals (V, 3) and quads (cells_u * cells_v, 4) of an even grid of the parameters, for drawing."""
        vertices, cells = (cells_u + 1) * (cells_v + 1), cells_u * cells_v
        if min(cells_u, cells_v) < 1 or vertices > 1 << 24:
            raise ArgumentError(native.INVALID_ARGUMENT, f"{cells_u} x {cells_v} cells, expected 1 and more, 2^24 vertices at most")
        points, normals = np.empty((vertices, 3)), np.empty((vertices, 3))
        quads = np.empty((cells, 4), dtype=np.uint32)
        out = [a.ctypes.data_as(ctypes.POINTER(ctypes.c_double)) for a in (points, normals)]
        out.append(quads.ctypes.data_as(ctypes.POINTER(ctypes.c_uint32)))
        _check(library().s2pq_surface_grid(self._surface._pointer, self._index, cells_u, cells_v, *out))
        return points, normals, quads

    @property
    def diagnostics(self):
        """How well the patch obeys the sketch."""
        struct = self._surface._struct("s2pq_surface_diagnostics", native.SurfaceDiagnostics, self._index)
        return _measures(struct)


class Surface(_Handle):
    """One or more NURBS patches; made by Session.surface or Surface.from_nurbs."""

    _free = "s2pq_surface_free"

    @classmethod
    def from_nurbs(cls, degrees, knots, control_points, weights=None):
        """A host's own patch: control_points (count_u, count_v, 3); knots in u and v in either convention."""
        net = np.ascontiguousarray(control_points, dtype=np.float64)
        if net.ndim != 3 or net.shape[2] != 3:
            raise ArgumentError(native.INVALID_ARGUMENT, f"control_points has shape {net.shape}, expected (u, v, 3)")
        arrays = [np.ascontiguousarray(k, dtype=np.float64).ravel() for k in knots] + [net]
        if weights is not None:
            arrays.append(np.ascontiguousarray(weights, dtype=np.float64))
            if arrays[3].shape != net.shape[:2]:
                raise ArgumentError(native.INVALID_ARGUMENT, f"weights has shape {arrays[3].shape}")
        pointers = [a.ctypes.data_as(ctypes.POINTER(ctypes.c_double)) for a in arrays]
        nurbs = native.Nurbs(
            struct_size=ctypes.sizeof(native.Nurbs),
            degree_u=degrees[0],
            degree_v=degrees[1],
            count_u=net.shape[0],
            count_v=net.shape[1],
            knot_count_u=len(arrays[0]),
            knot_count_v=len(arrays[1]),
            knots_u=pointers[0],
            knots_v=pointers[1],
            control_points=pointers[2],
        )
        if weights is not None:
            nurbs.weights = pointers[3]
        pointer = ctypes.c_void_p()
        _check(library().s2pq_surface_from_nurbs(ctypes.byref(nurbs), ctypes.byref(pointer)))
        return cls(pointer)

    @property
    def patches(self):
        """The patches."""
        count = ctypes.c_size_t()
        _check(library().s2pq_surface_patch_count(self._pointer, ctypes.byref(count)))
        return [Patch(self, index) for index in range(count.value)]

    @property
    def unused_strokes(self):
        """Strokes that played no part, by their place in the sketch."""
        return self._array("s2pq_surface_unused_strokes", ctypes.c_uint32)

    @property
    def report(self):
        """Measures and times."""
        return json.loads(self._string("s2pq_surface_report_json"))


class Field(_Handle):
    """A conjugate pair of directions on every triangle of a surface; made by Session.field."""

    _free = "s2pq_field_free"

    @property
    def vertices(self):
        """(V, 3)"""
        return self._array("s2pq_field_vertices", ctypes.c_double, 3)

    @property
    def triangles(self):
        """(T, 3)"""
        return self._array("s2pq_field_triangles", ctypes.c_uint32, 3)

    @property
    def directions(self):
        """(T, 2, 3): u and v of each triangle, unit."""
        return self._array("s2pq_field_directions", ctypes.c_double, 6).reshape(-1, 2, 3)

    @property
    def singularities(self):
        """Singular vertices and their indices in quarter turns."""
        vertices, indices = ctypes.POINTER(ctypes.c_uint32)(), ctypes.POINTER(ctypes.c_int32)()
        count = ctypes.c_size_t()
        _check(
            library().s2pq_field_singularities(
                self._pointer, ctypes.byref(vertices), ctypes.byref(indices), ctypes.byref(count)
            )
        )
        return self._view(vertices, count.value), self._view(indices, count.value)

    @property
    def floor_triangles(self):
        """Triangles where a hard curve left no conjugate pair above the smallest crossing angle."""
        return self._array("s2pq_field_floor_triangles", ctypes.c_uint32)

    @property
    def diagnostics(self):
        """How good the field is."""
        return _measures(self._struct("s2pq_field_diagnostics", native.FieldDiagnostics))

    @property
    def report(self):
        """Measures and times so far."""
        return json.loads(self._string("s2pq_field_report_json"))


class Mesh(_Handle):
    """Planar panels; made by Session.mesh or Session.planarize."""

    _free = "s2pq_mesh_free"

    @property
    def vertices(self):
        """(V, 3)"""
        return self._array("s2pq_mesh_vertices", ctypes.c_double, 3)

    @property
    def starts_indices(self):
        """Face f has the vertices indices[starts[f]:starts[f + 1]]."""
        starts, indices = ctypes.POINTER(ctypes.c_uint32)(), ctypes.POINTER(ctypes.c_uint32)()
        count = ctypes.c_size_t()
        _check(
            library().s2pq_mesh_faces(
                self._pointer, ctypes.byref(starts), ctypes.byref(indices), ctypes.byref(count)
            )
        )
        starts = self._view(starts, count.value + 1)
        return starts, self._view(indices, int(starts[-1]))

    @property
    def faces(self):
        """List of faces, each an array of vertex indices, counter-clockwise seen from the surface's front."""
        starts, indices = self.starts_indices
        return np.split(indices, starts[1:-1])

    @property
    def planarity(self):
        """(F,) distance of the diagonals over the mean edge length."""
        return self._array("s2pq_mesh_planarity", ctypes.c_double)

    @property
    def deviation(self):
        """(V,) distance from the surface."""
        return self._array("s2pq_mesh_deviation", ctypes.c_double)

    @property
    def on_border(self):
        """(V,) whether a vertex lies on the mesh's border."""
        return self._array("s2pq_mesh_border", ctypes.c_uint8).view(np.bool_)

    @property
    def irregular_vertices(self):
        """Inner vertices where another number than four faces meets."""
        return self._array("s2pq_mesh_irregular_vertices", ctypes.c_uint32)

    @property
    def measures(self):
        """Numbers of faces and quads, worst and mean planarity, deviation, edge length, time."""
        return _measures(self._struct("s2pq_mesh_report", native.MeshReport))

    @property
    def report(self):
        """Measures and times of all stages."""
        return json.loads(self._string("s2pq_mesh_report_json"))

    @property
    def obj(self):
        """The mesh as OBJ text."""
        return self._string("s2pq_mesh_obj")


class Session(_Handle):
    """Loaded networks, threads, progress and cancel."""

    _free = "s2pq_session_free"

    def __init__(self, backend="auto", runtime_path=None, models_folder=None, threads=None, progress=None, live=False):
        """`live`: surface() begins with the last sketch's where little changed, and stops the session's older call on another thread,
        which raises Cancelled; the result then depends on what was drawn before."""
        options = _options(
            native.SessionOptions,
            "s2pq_session_options_init",
            backend=_number(BACKENDS, backend, "backend"),
            threads=threads,
            live=int(live),
            runtime_path=str(runtime_path).encode() if runtime_path else None,
            models_folder=str(models_folder).encode() if models_folder else None,
        )
        pointer = ctypes.c_void_p()
        _check(library().s2pq_session_new(ctypes.byref(options), ctypes.byref(pointer)))
        super().__init__(pointer)
        self._callback = None
        self._raised = None
        self.set_progress(progress)

    def set_progress(self, progress):
        """Calls `progress(stage, fraction)` during later calls, on the thread that calls; None ends it.

        An exception that it raises cancels the call, which raises it then.
        """

        def call(_, stage, fraction):
            try:
                progress(stage.decode(), fraction)
            except BaseException as raised:
                self._raised = raised
                library().s2pq_cancel(self._pointer)

        callback = native.Progress(call) if progress else None
        pointer = ctypes.cast(callback, ctypes.c_void_p) if callback else None
        _check(library().s2pq_session_set_progress(self._pointer, pointer, None))
        self._callback = callback

    def cancel(self):
        """Stops the running call, or the next one, from any thread."""
        _check(library().s2pq_cancel(self._pointer))

    @property
    def backend(self):
        """What runs the networks: name, version, path."""
        text = ctypes.c_char_p()
        _check(library().s2pq_session_backend(self._pointer, ctypes.byref(text)))
        return text.value.decode()

    def _call(self, result, export, *arguments):
        pointer = ctypes.c_void_p()
        try:
            _check(getattr(library(), export)(self._pointer, *arguments, ctypes.byref(pointer)))
        except Cancelled:
            raised, self._raised = self._raised, None
            if raised is not None:
                raise raised from None
            raise
        return result(pointer)

    def surface(self, sketch, corners=None, fairness=None):
        """Sketch to surface; `corners`: four (x, y) on the canvas, near the outline; `fairness`: 1 is balanced."""
        array, pointer = (None, None) if corners is None else _doubles(corners, 2, "corners")
        if array is not None and len(array) != 4:
            raise ArgumentError(native.INVALID_ARGUMENT, f"{len(array)} corners, expected 4")
        options = _options(native.SurfaceOptions, "s2pq_surface_options_init", corners=pointer, fairness=fairness)
        return self._call(Surface, "sketch_to_surface", sketch._pointer, ctypes.byref(options))

    def field(
        self,
        surface,
        sketch=None,
        use_network=None,
        align_border=None,
        resolution=None,
        crossing_floor_deg=None,
        curves=None,
        hard=False,
        singularities=None,
        faces=None,
        edge_length=None,
    ):
        """Surface to a conjugate direction field, aligned with the sketch's feature lines or with curves in space.

        `curves`: arrays of (x, y, z) on or near the surface, instead of a sketch; `hard`: whether they are followed exactly, one truth
        value for all or one for each. `align_border`: True, or some of SIDES. `singularities`: what the field shall have and no others, each
        ((x, y, z), index) in space, or ((u, v), index) and perhaps the number of the patch; the index is 1 where three quads meet, -1 where
        five do. `faces` or `edge_length`: as the mesh will be asked for; an aligned border that turns within a panel's length has corners there.
        """
        options = _options(
            native.FieldOptions,
            "s2pq_field_options_init",
            use_network=None if use_network is None else int(bool(use_network)),
            align_border=None if align_border is None else _sides(align_border),
            resolution=resolution,
            crossing_floor_deg=crossing_floor_deg,
            faces=faces,
            edge_length=edge_length,
        )
        if singularities is not None:
            # Kept until the call ends: the options point into them.
            fixed, kept = _singularities(singularities)
            options.singularities = ctypes.pointer(fixed)
        if sketch is not None:
            if curves is not None:
                raise ArgumentError(native.INVALID_ARGUMENT, "a sketch and curves, expected one of them")
            return self._call(Field, "sketch_to_cdf", sketch._pointer, surface._pointer, ctypes.byref(options))
        # Kept until the call ends: the struct points into them.
        arrays = [_doubles(curve, 3, "curves")[0] for curve in (() if curves is None else curves)]
        starts = np.cumsum([0] + [len(array) for array in arrays], dtype=np.uint32)
        points, points_pointer = _doubles(np.concatenate(arrays) if arrays else [], 3, "curves")
        flags = np.ascontiguousarray(np.broadcast_to(hard, len(arrays)), dtype=np.uint8)
        given = native.Curves(
            struct_size=ctypes.sizeof(native.Curves),
            curve_count=len(arrays),
            starts=starts.ctypes.data_as(ctypes.POINTER(ctypes.c_uint32)),
            points=points_pointer,
            hard=flags.ctypes.data_as(ctypes.POINTER(ctypes.c_uint8)),
        )
        pointers = (surface._pointer, ctypes.byref(given), ctypes.byref(options))
        return self._call(Field, "surface_to_cdf", *pointers)

    def mesh(
        self,
        field,
        faces=None,
        edge_length=None,
        border="trimmed",
        planarity=None,
        strict=None,
        offsets="any",
        hold="slide",
    ):
        """Field to panels; `border` is a key of BORDERS, `offsets` of OFFSETS, `hold` of HOLDS."""
        options = _options(
            native.MeshOptions,
            "s2pq_mesh_options_init",
            border=_number(BORDERS, border, "border"),
            faces=faces,
            edge_length=edge_length,
            planarity=planarity,
            strict=None if strict is None else int(bool(strict)),
            offsets=_number(OFFSETS, offsets, "offsets"),
            hold=_number(HOLDS, hold, "hold"),
        )
        return self._call(Mesh, "extract_pq_mesh", field._pointer, ctypes.byref(options))

    def planarize(
        self,
        vertices,
        faces,
        surface=None,
        pins=(),
        planarity=None,
        deviation=None,
        closeness=None,
        fairness=None,
        anchor=None,
        strict=None,
        offsets="any",
        hold="slide",
    ):
        """Your own polygons to planar ones: `faces` is a list of lists of vertices, `pins` are vertices that do not move.

        They stay on `surface`, which has one patch, or without one on themselves. A large `anchor` keeps each vertex near its place. `offsets` is a key of OFFSETS, `hold` of HOLDS.
        """
        array, pointer = _doubles(vertices, 3, "vertices")
        lists = [_indices(face, "faces") for face in faces]
        starts = _indices(np.cumsum([0] + [len(face) for face in lists]), "faces")
        indices = np.concatenate([np.empty(0, np.uint32), *lists])
        pins = _indices(pins, "pins")
        u32s = ctypes.POINTER(ctypes.c_uint32)
        polygons = native.Polygons(
            struct_size=ctypes.sizeof(native.Polygons),
            vertex_count=len(array),
            face_count=len(lists),
            pin_count=len(pins),
            vertices=pointer,
            starts=starts.ctypes.data_as(u32s),
            indices=indices.ctypes.data_as(u32s),
            pins=pins.ctypes.data_as(u32s),
        )
        options = _options(
            native.PlanarizeOptions,
            "s2pq_planarize_options_init",
            planarity=planarity,
            deviation=deviation,
            closeness=closeness,
            fairness=fairness,
            anchor=anchor,
            strict=None if strict is None else int(bool(strict)),
            offsets=_number(OFFSETS, offsets, "offsets"),
            hold=_number(HOLDS, hold, "hold"),
        )
        surface = surface._pointer if surface is not None else None
        return self._call(Mesh, "s2pq_planarize", ctypes.byref(polygons), surface, ctypes.byref(options))
