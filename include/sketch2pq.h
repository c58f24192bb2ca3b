/* sketch2pq: an architect's sketch in, a NURBS surface and a mesh of planar quads out.
 *
 * Written by cbindgen from src/ffi; do not edit.
 *
 * The pipeline
 *   S2pqSketch  -- sketch_to_surface -->  S2pqSurface  -- sketch_to_cdf -->  S2pqField  -- extract_pq_mesh -->  S2pqMesh
 *   A host that has a NURBS surface enters by s2pq_surface_from_nurbs, and goes on with surface_to_cdf and its own feature curves.
 *
 * Calls
 *   Every call that can fail returns an S2pqStatus and writes its outputs only on success. The status says what to do; s2pq_last_message,
 *   asked on the same thread before its next call, says what happened. No call ends the process, whatever it is given of NULL
 *   pointers, freed handles and handles of another kind; arrays and structs must be as large as their counts and sizes say.
 *
 * Handles
 *   Opaque; made by the library, freed by the function named s2pq_..._free, which takes NULL too. Inputs are borrowed for the call. Arrays and
 *   texts that come out are lent by a handle and die with it. Results do not need the handles that they were made from.
 *
 * Structs
 *   Every struct begins with its own size. Options: call s2pq_..._options_init(&options, sizeof options), then change fields. Results: set
 *   struct_size = sizeof the struct before the call. Fields are only ever appended, and a library takes the structs of older and of
 *   newer headers; an option that it does not know must be zero.
 *
 * Enumerations arrive as uint32_t and are checked.
 *
 * Threads
 *   One thread at a time for each handle, any thread; different handles are independent. s2pq_cancel stops a session's call from any thread,
 *   and on a session made with live = 1 so does a newer sketch_to_surface: the older call answers S2PQ_STATUS_CANCELLED.
 *   Progress callbacks run on the thread that called. They must not throw or long-jump.
 *
 * Frames and units
 *   Canvas: the host's own unit, x right, y up or down as the sketch's view says. World: right-handed, z up, in the canvas' unit. Depth is
 *   measured along the view and grows away from the viewer. Angles are in degrees, times in milliseconds. All numbers are double precision,
 *   all texts UTF-8.
 */

#ifndef SKETCH2PQ_H
#define SKETCH2PQ_H

#include <stddef.h>
#include <stdint.h>

/* What s2pq_abi_version returns for this header: 1000 * major + minor of the version. */
#define S2PQ_ABI_VERSION 1u

// What a call answers. The number says what to do, s2pq_last_message says what happened and where.
enum S2pqStatus
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  // Done.
  S2PQ_STATUS_OK = 0,
  // An argument, a handle or a struct size is wrong: fix the call.
  S2PQ_STATUS_INVALID_ARGUMENT = 1,
  // The sketch is empty, open, or contradicts itself: change the drawing where the message says.
  S2PQ_STATUS_INVALID_SKETCH = 2,
  // The surface, field or mesh is degenerate: change the geometry.
  S2PQ_STATUS_INVALID_GEOMETRY = 3,
  // A target could not be reached: relax it.
  S2PQ_STATUS_NOT_REACHED = 4,
  // The host cancelled the call.
  S2PQ_STATUS_CANCELLED = 5,
  // A file, a model or the requested backend cannot be used: repair the installation.
  S2PQ_STATUS_UNAVAILABLE = 6,
  // A defect of the library: report it with the message.
  S2PQ_STATUS_INTERNAL = 7,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum S2pqStatus S2pqStatus;
#else
typedef uint32_t S2pqStatus;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// What a stroke stands for; passed as uint32_t.
enum S2pqStrokeKind
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  // Visible part of the surface's border; green in the paper.
  S2PQ_STROKE_KIND_VISIBLE_BOUNDARY = 0,
  // Occluded part of the surface's border; blue.
  S2PQ_STROKE_KIND_OCCLUDED_BOUNDARY = 1,
  // Silhouette of the surface that is not its border: the surface folds over there; red.
  S2PQ_STROKE_KIND_CONTOUR = 2,
  // Direction that the panels' edges follow; black.
  S2PQ_STROKE_KIND_FEATURE = 3,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum S2pqStrokeKind S2pqStrokeKind;
#else
typedef uint32_t S2pqStrokeKind;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// Which of the two surface layers on a line of sight; passed as uint32_t.
enum S2pqLayer
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  // First surface point.
  S2PQ_LAYER_VISIBLE = 0,
  // Second surface point.
  S2PQ_LAYER_OCCLUDED = 1,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum S2pqLayer S2pqLayer;
#else
typedef uint32_t S2pqLayer;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// Which backend runs the networks; passed as uint32_t.
enum S2pqBackend
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  // ONNX Runtime if a usable one is found, else the embedded engine.
  S2PQ_BACKEND_AUTO = 0,
  // ONNX Runtime, or an error.
  S2PQ_BACKEND_ORT = 1,
  // The engine inside the library.
  S2PQ_BACKEND_EMBEDDED = 2,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum S2pqBackend S2pqBackend;
#else
typedef uint32_t S2pqBackend;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// What becomes of the cells at the border; passed as uint32_t.
enum S2pqBorder
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  // Cells cut by the border become planar polygons whose border vertices lie on the surface's border.
  S2PQ_BORDER_TRIMMED = 0,
  // The field follows the border, and so do edge loops. Asks for a field made with align_border = 1 to do it well.
  S2PQ_BORDER_ALIGNED = 1,
  // Whole quads only; the mesh ends inside the border.
  S2PQ_BORDER_INTERIOR = 2,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum S2pqBorder S2pqBorder;
#else
typedef uint32_t S2pqBorder;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// What vertices on the border of a mesh may do while its faces become planar; passed as uint32_t.
enum S2pqHold
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  // Move along the border of the surface, or of the mesh as it is given.
  S2PQ_HOLD_SLIDE = 0,
  // Not move at all.
  S2PQ_HOLD_PINNED = 1,
  // Move like any other vertex.
  S2PQ_HOLD_FREE = 2,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum S2pqHold S2pqHold;
#else
typedef uint32_t S2pqHold;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// Offsets that a mesh should have, as far as planarity and closeness allow; passed as uint32_t.
enum S2pqOffsets
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  // Any.
  S2PQ_OFFSETS_ANY = 0,
  // Each quad has a circumscribed circle: offsets at constant distance between vertices.
  S2PQ_OFFSETS_CIRCULAR = 1,
  // The panels around each vertex touch a cone: offsets at constant distance between panels.
  S2PQ_OFFSETS_CONICAL = 2,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum S2pqOffsets S2pqOffsets;
#else
typedef uint32_t S2pqOffsets;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// A conjugate pair of directions on every triangle of a surface. Made by sketch_to_cdf or surface_to_cdf; independent of the surface's
// handle.
typedef struct S2pqField S2pqField;

// Planar panels: vertices and polygons, world frame, canvas unit. Made by extract_pq_mesh or s2pq_planarize; independent
// of the handles that it was made from.
typedef struct S2pqMesh S2pqMesh;

// Loaded networks, threads, progress and cancel. Cheap to keep; made by s2pq_session_new.
//
// One call at a time: a call that finds the session at work on another thread answers S2PQ_STATUS_INVALID_ARGUMENT at
// once. Only s2pq_cancel and s2pq_cancel_reset may be called from any thread at any time, and on a live session
// sketch_to_surface: there the older call soon answers S2PQ_STATUS_CANCELLED, as do those that wait when yet a newer one comes, and the
// newest waits for the session and runs. A handle that the older call reads or writes must not be freed or changed before it has
// answered: give each call a sketch of its own.
typedef struct S2pqSession S2pqSession;

// Strokes and depth samples on a canvas, and the view. Made by s2pq_sketch_new, s2pq_sketch_from_json or
// s2pq_sketch_from_svg.
//
// Canvas coordinates are the host's own, in any unit. The default view is azimuth 45, elevation 45 degrees, canvas y
// down.
typedef struct S2pqSketch S2pqSketch;

// One or more NURBS patches, world frame (right-handed, z up), canvas unit. Made by sketch_to_surface or
// s2pq_surface_from_nurbs.
typedef struct S2pqSurface S2pqSurface;

// How a session is made. Fill it by s2pq_session_options_init, then change what you need.
typedef struct S2pqSessionOptions {
  // sizeof(S2pqSessionOptions)
  uint32_t struct_size;
  // An S2pqBackend. Default: S2PQ_BACKEND_AUTO.
  uint32_t backend;
  // Threads for the stages; 0: as many as the machine has cores, the default. At most 256.
  uint32_t threads;
  // 1 for a sketch that is drawn while the host looks on, else 0, the default. Then sketch_to_surface begins with the last surface where
  // the outline, its corners and contours moved by eight pixels of 256 at most, and a newer sketch_to_surface stops the session's
  // older call. The price: a surface depends on what was drawn before, within what the strokes leave open; with 0 the same sketch gives
  // the same bytes.
  uint32_t live;
  // File or folder of the ONNX Runtime, UTF-8, absolute; NULL: search for one. Lent for the call.
  const char *runtime_path;
  // Folder with manifest.json and models to use instead of the built-in ones, UTF-8; NULL: the built-in ones. Lent
  // for the call.
  const char *models_folder;
} S2pqSessionOptions;

// Called on the thread that called the stage, at least some times a second, with the stage's name (UTF-8, valid during
// the callback) and the fraction of that stage that is done, in [0, 1].
//
// Must not throw, long-jump or call anything of this session but s2pq_cancel.
typedef void (*S2pqProgress)(void *user, const char *stage, double fraction);

// Options of sketch_to_surface. Fill them by s2pq_surface_options_init, then change what you need.
typedef struct S2pqSurfaceOptions {
  // sizeof(S2pqSurfaceOptions)
  uint32_t struct_size;
  // Zero.
  uint32_t reserved;
  // Four corners of the surface, x and y each, canvas frame, near the outline and in any order; NULL: they are
  // found, the default. Lent for the call. Only for a sketch with one outline.
  const double *corners;
  // Smoothness against detail: 1 is balanced, 10 irons out small waves, 0.1 follows the predicted depth closely.
  // Default 1.
  double fairness;
} S2pqSurfaceOptions;

// One NURBS patch, in or out. Set struct_size before every use.
//
// Knots are the textbook's: count + degree + 1, clamped. Rhino and openNURBS store the same vector without its first
// and last entry, count + degree - 1: pass those as they are, and read them as `knots_u + 1` with `knot_count_u - 2`
// entries.
typedef struct S2pqNurbs {
  // sizeof(S2pqNurbs)
  uint32_t struct_size;
  // Degree in u, 1 to 5.
  uint32_t degree_u;
  // Degree in v, 1 to 5.
  uint32_t degree_v;
  // Zero.
  uint32_t reserved;
  // Number of control points in u.
  uint64_t count_u;
  // Number of control points in v.
  uint64_t count_v;
  // Number of knots in u: count_u + degree_u + 1, or in also count_u + degree_u - 1.
  uint64_t knot_count_u;
  // Number of knots in v: count_v + degree_v + 1, or in also count_v + degree_v - 1.
  uint64_t knot_count_v;
  // Knots in u.
  const double *knots_u;
  // Knots in v.
  const double *knots_v;
  // count_u * count_v times x, y, z, v running fastest; world frame (right-handed, z up). Not multiplied by the
  // weights.
  const double *control_points;
  // count_u * count_v positive weights in the same order; NULL if all are 1.
  const double *weights;
} S2pqNurbs;

// How well a patch obeys the sketch. Set struct_size before the call. All zero for a host's own NURBS.
typedef struct S2pqSurfaceDiagnostics {
  // sizeof(S2pqSurfaceDiagnostics)
  uint32_t struct_size;
  // Places of a grid over the patch where it turns from front to back, seen along the view, and no contour is drawn.
  uint32_t fold_overs;
  // Mean distance between the structural strokes and the projected border and silhouette, pixels of a 256 x 256
  // canvas that the sketch fills.
  double reprojection_mean_px;
  // Largest of the same.
  double reprojection_max_px;
  // Largest distance along the view between a depth sample and the surface, canvas unit; 0 without samples.
  double sample_residual;
  // Share of the patch whose side facing the viewer is not drawn there, in [0, 1].
  double misfacing;
  // 1 if the surface began with that of the sketch before, in a live session; else 0.
  uint32_t warm_start;
  // Zero.
  uint32_t reserved;
} S2pqSurfaceDiagnostics;

// Singularities that a field shall have, lent to sketch_to_cdf and surface_to_cdf by their options. Set struct_size before the call, and
// clear the rest.
//
// The field has each of them at the nearest inner vertex of its triangulation. Where a side of the patch is not aligned, any will do;
// where all sides are, the indices have to sum to 4 less one for each corner of the border of about 90 degrees, 0 with four such corners.
typedef struct S2pqSingularities {
  // sizeof(S2pqSingularities)
  uint32_t struct_size;
  // Not used; 0.
  uint32_t reserved;
  // Number of singularities.
  uint64_t count;
  // x, y, z of each, world frame; they are brought to the nearest points of the surface, at most a tenth of its size away. NULL where
  // `parameters` are given.
  const double *points;
  // u, v of each; NULL where `points` are given.
  const double *parameters;
  // For each the patch of its `parameters`; NULL: all on patch 0.
  const uint32_t *patches;
  // For each its index in quarter turns: 1 where three, -1 where five quads meet.
  const int32_t *indices;
} S2pqSingularities;

// Options of sketch_to_cdf and surface_to_cdf. Fill them by s2pq_field_options_init, then change what you need.
//
// `singularities` is read during the call and stays the host's.
typedef struct S2pqFieldOptions {
  // sizeof(S2pqFieldOptions)
  uint32_t struct_size;
  // 1: the network's guess steers the field where the sketch has an outline, the default; 0: feature lines and
  // smoothness alone.
  uint32_t use_network;
  // 0, the default: the directions may cross the border; 1: one family follows it; else the sum of the sides that
  // it follows: 2 for u = min, 4 for u = max, 8 for v = min, 16 for v = max.
  uint32_t align_border;
  // Cells of the triangulation along the longer side of a patch; 0, the default: chosen by the library. 8 to 256.
  uint32_t resolution;
  // Smallest crossing angle of the two families, degrees, in (0, 80]. Default 20.
  double crossing_floor_deg;
  // The singularities that the field shall have, and no others: a count of 0 asks for none. NULL, the default: the solver places
  // what it needs.
  const struct S2pqSingularities *singularities;
  // Edge length that the mesh will be asked for, canvas unit; 0, the default: that of the wanted number of faces. Where an aligned border
  // turns by more than 45 degrees within it the panels have a corner; nothing else depends on it.
  double edge_length;
  // Faces over all patches that the mesh will be asked for, where edge_length is 0. Default 500.
  uint32_t faces;
  // Not used; 0.
  uint32_t reserved;
} S2pqFieldOptions;

// Curves on or near a surface, lent to surface_to_cdf. Set struct_size before the call, and clear the rest.
typedef struct S2pqCurves {
  // sizeof(S2pqCurves)
  uint32_t struct_size;
  // Not used; 0.
  uint32_t reserved;
  // Number of curves.
  uint64_t curve_count;
  // First point of each curve and, last, the number of points: curve_count + 1 entries, each curve two points or more.
  const uint32_t *starts;
  // x, y, z of all points, world frame; they are brought to the nearest points of the surface, at most a tenth of its
  // size away.
  const double *points;
  // For each curve 1: one family follows it exactly, or 0: it yields where curves contradict each other; NULL: all 0.
  const uint8_t *hard;
} S2pqCurves;

// How good a field is, over all its patches. Set struct_size before the call.
typedef struct S2pqFieldDiagnostics {
  // sizeof(S2pqFieldDiagnostics)
  uint32_t struct_size;
  // Number of singular vertices.
  uint32_t singularities;
  // Mean over the curved triangles of |II(u, v)| / (|II| |u| |v|), in [0, 1/sqrt 2].
  double conjugacy_mean;
  // Largest of the same.
  double conjugacy_max;
  // Smallest angle between the two families, degrees.
  double crossing_min_deg;
  // Mean angle between the feature lines and the nearer family, degrees; 0 without feature lines.
  double feature_angle_deg;
} S2pqFieldDiagnostics;

// Options of extract_pq_mesh. Fill them by s2pq_mesh_options_init, then change what you need.
typedef struct S2pqMeshOptions {
  // sizeof(S2pqMeshOptions)
  uint32_t struct_size;
  // An S2pqBorder. Default: S2PQ_BORDER_TRIMMED.
  uint32_t border;
  // Wanted number of faces over all patches, where edge_length is 0. Default 500.
  uint32_t faces;
  // 1: a mesh whose planarity misses the target is S2PQ_STATUS_NOT_REACHED; 0, the default: it is given with its
  // measures.
  uint32_t strict;
  // Wanted edge length, canvas unit; 0, the default: chosen to give the wanted number of faces.
  double edge_length;
  // Wanted planarity of the worst face: distance of the diagonals over the mean edge length. Default 1e-6.
  double planarity;
  // An S2pqOffsets. Default: S2PQ_OFFSETS_ANY.
  uint32_t offsets;
  // An S2pqHold. Default: S2PQ_HOLD_SLIDE.
  uint32_t hold;
} S2pqMeshOptions;

// Measures of a mesh, over all its patches. Set struct_size before the call.
typedef struct S2pqMeshReport {
  // sizeof(S2pqMeshReport)
  uint32_t struct_size;
  // Number of faces.
  uint32_t faces;
  // Number of faces with four corners.
  uint32_t quads;
  // Number of inner vertices where another number than four edges meets.
  uint32_t irregular_vertices;
  // Planarity of the worst face: distance of the diagonals over the mean edge length.
  double planarity_max;
  // Mean planarity.
  double planarity_mean;
  // Largest distance between a vertex and the surface, canvas unit.
  double deviation_max;
  // The same over the mean edge length.
  double deviation_max_edges;
  // Mean edge length, canvas unit.
  double edge_length_mean;
  // Share of the surface's border, by length, that lies within a tenth of the mean edge length of the mesh's border,
  // in [0, 1]; 0 without a surface.
  double border_covered;
  // Milliseconds of all stages together, from the sketch on.
  double time_ms;
  // Largest distance between a vertex and the surface over what was allowed: 2 % of the patch's width or a fifth of its mean edge length,
  // whichever is smaller, unless the host said otherwise. Above 1 planarity and closeness contradict each other.
  double deviation_over_limit;
  // Largest distance between a border vertex and the surface's border over the patch's width; 0 where border vertices are free.
  double border_deviation_widths;
} S2pqMeshReport;

// Options of s2pq_planarize. Fill them by s2pq_planarize_options_init, then change what you need.
typedef struct S2pqPlanarizeOptions {
  // sizeof(S2pqPlanarizeOptions)
  uint32_t struct_size;
  // An S2pqOffsets. Default: S2PQ_OFFSETS_ANY.
  uint32_t offsets;
  // An S2pqHold. Default: S2PQ_HOLD_SLIDE.
  uint32_t hold;
  // 1: a mesh whose planarity misses the target is S2PQ_STATUS_NOT_REACHED; 0, the default: it is given with its
  // measures.
  uint32_t strict;
  // Wanted planarity of the worst face: distance of the diagonals over the mean edge length. Default 1e-6.
  double planarity;
  // Distance to the surface that no vertex should exceed, the mesh's unit; 0, the default: 2 % of the mesh's width or
  // a fifth of its mean edge length, whichever is smaller.
  double deviation;
  // Weight of the squared distance to the surface, in mean edge lengths. Default 1.
  double closeness;
  // Weight of the change of the second differences along the polylines. Default 0.5.
  double fairness;
  // Weight of the squared distance from where each vertex started; above 0. Default 0.01: vertices slide within the surface. 1 and more, with
  // little fairness: each stays near its place.
  double anchor;
} S2pqPlanarizeOptions;

// A host's own polygon mesh, lent for a call. Set struct_size first.
typedef struct S2pqPolygons {
  // sizeof(S2pqPolygons)
  uint32_t struct_size;
  // Zero.
  uint32_t reserved;
  // Number of vertices.
  uint64_t vertex_count;
  // Number of faces.
  uint64_t face_count;
  // Number of vertices that do not move at all.
  uint64_t pin_count;
  // vertex_count times x, y, z; world frame, any unit.
  const double *vertices;
  // face_count + 1 entries: face f has the vertices `indices[starts[f]]` to `indices[starts[f + 1] - 1]`.
  const uint32_t *starts;
  // `starts[face_count]` entries.
  const uint32_t *indices;
  // pin_count vertices, in any order; NULL if there is none.
  const uint32_t *pins;
} S2pqPolygons;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// The English name of a status, never NULL, static.
//
// - `status`: an S2pqStatus; any other number has the name "unknown status".
const char *s2pq_status_name(uint32_t status);

// The version of the ABI, 1000 * major + minor.
//
// Check on load that it equals S2PQ_ABI_VERSION: until version 1.0 every minor version may change the ABI; from then
// on a library serves every host of the same major version that was compiled against its own or a smaller minor
// version.
uint32_t s2pq_abi_version(void);

// The version of the library as text, "major.minor.patch"; static.
const char *s2pq_version(void);

// Copies what the last fallible call on this thread had to say; empty after a success.
//
// Ask on the thread that got the status, before its next call.
//
// - `buffer`: takes the UTF-8 text, cut where it does not fit, always NUL-terminated; may be NULL if `capacity` is 0.
// - `capacity`: size of the buffer in bytes.
// - returns the length of the whole message in bytes, without the NUL.
//
// Must be valid:
// `buffer` is valid for writing `capacity` bytes.
size_t s2pq_last_message(char *buffer, size_t capacity);

// Gives every option its default.
//
// - `options`: takes the defaults.
// - `size`: sizeof(S2pqSessionOptions) as the host compiled it.
//
// Must be valid:
// `options` is valid for writing `size` bytes.
S2pqStatus s2pq_session_options_init(struct S2pqSessionOptions *options, size_t size);

// Loads the networks and starts the threads. Takes some tens of milliseconds.
//
// - `options`: NULL for the defaults.
// - `session`: takes the new session.
// - S2PQ_STATUS_UNAVAILABLE: the requested backend or a model cannot be used; the message says why.
//
// Must be valid:
// `options` is NULL or valid as its `struct_size` says; `session` is valid for writing.
S2pqStatus s2pq_session_new(const struct S2pqSessionOptions *options, struct S2pqSession **session);

// Reports the progress of later calls to `callback`; NULL ends it.
//
// - `user`: handed to the callback; must stay valid until another callback is set or the session is freed.
//
// Must be valid:
// `callback` may be called with `user`, on each thread that calls a stage.
S2pqStatus s2pq_session_set_progress(struct S2pqSession *session, S2pqProgress callback, void *user);

// Which backend runs, for reports: name, version and path. Lent until the session is freed.
//
// Must be valid:
// `text` is valid for writing.
S2pqStatus s2pq_session_backend(const struct S2pqSession *session, const char **text);

// Stops the call that the session is at work on, from any thread: it soon answers S2PQ_STATUS_CANCELLED.
//
// Every stage looks between its networks and in every outer iteration, some tens of milliseconds apart at most. If no
// call is at work, the next one is stopped; s2pq_cancel_reset forgets such a cancel. Each call forgets the cancel when
// it returns.
//
// Must be valid:
// The session is not freed during the call.
S2pqStatus s2pq_cancel(const struct S2pqSession *session);

// Forgets a cancel that came too late to stop a call; from any thread.
//
// Must be valid:
// The session is not freed during the call.
S2pqStatus s2pq_cancel_reset(const struct S2pqSession *session);

// Frees a session; NULL is fine. Surfaces, fields and meshes that it made stay alive.
//
// Must be valid:
// No call uses the session.
void s2pq_session_free(struct S2pqSession *session);

// Makes an empty sketch.
//
// Must be valid:
// `sketch` is valid for writing.
S2pqStatus s2pq_sketch_new(struct S2pqSketch **sketch);

// Reads a sketch from JSON text, the form of the files in examples/sketches.
//
// - `text`, `length`: UTF-8 without NUL, `length` bytes.
// - `sketch`: takes the new sketch.
//
// Must be valid:
// `text` is valid for reading `length` bytes, `sketch` for writing.
S2pqStatus s2pq_sketch_from_json(const uint8_t *text, size_t length, struct S2pqSketch **sketch);

// Reads a sketch from SVG text, as drawing programs write it; canvas y is down, the view is the default.
//
// The kind of a stroke comes from the names of its layer, group, class or id (visible boundary, occluded, contour,
// feature), else from its colour: the nearest of green, blue, red and black. Circles with a number in data-depth or in
// their title are depth samples, of the occluded layer if their data-layer, class, id or group says so.
//
// - `text`, `length`: UTF-8 without NUL, `length` bytes.
// - `sketch`: takes the new sketch.
//
// Must be valid:
// `text` is valid for reading `length` bytes, `sketch` for writing.
S2pqStatus s2pq_sketch_from_svg(const uint8_t *text, size_t length, struct S2pqSketch **sketch);

// Sets the view by two angles in degrees.
//
// - `azimuth_deg`: of the direction towards the viewer, from world x towards y.
// - `elevation_deg`: of the same direction above the horizon, in [-90, 90]. World z is up.
// - `y_down`: 1 if canvas y grows downwards, as in images, else 0.
//
// Must be valid:
// `sketch` is NULL or any pointer.
S2pqStatus s2pq_sketch_set_view_angles(struct S2pqSketch *sketch,
                                       double azimuth_deg,
                                       double elevation_deg,
                                       uint32_t y_down);

// Sets the view by three orthonormal, right-handed axes in the world.
//
// - `axes`: nine numbers: canvas right, canvas up, towards the viewer.
// - `y_down`: 1 if canvas y grows downwards, as in images, else 0.
//
// Must be valid:
// `axes` is valid for reading nine numbers.
S2pqStatus s2pq_sketch_set_view_axes(struct S2pqSketch *sketch, const double *axes, uint32_t y_down);

// Adds a stroke. Strokes may come in any order and direction, with small gaps and overshoots.
//
// - `kind`: an S2pqStrokeKind.
// - `xy`: `point_count` times x and y, canvas frame.
// - A number that is not finite is S2PQ_STATUS_INVALID_SKETCH, and so is a sketch of more points than the library
//   takes.
//
// Must be valid:
// `xy` is valid for reading 2 * `point_count` numbers.
S2pqStatus s2pq_sketch_add_stroke(struct S2pqSketch *sketch, uint32_t kind, const double *xy, size_t point_count);

// Adds a known depth.
//
// - `layer`: an S2pqLayer.
// - `x`, `y`: canvas point.
// - `depth`: distance along the view direction from the plane through the world's origin, growing away from the
//   viewer, canvas unit.
//
// Must be valid:
// `sketch` is NULL or any pointer.
S2pqStatus s2pq_sketch_add_depth_sample(struct S2pqSketch *sketch, uint32_t layer, double x, double y, double depth);

// Removes all strokes and depth samples; the view stays.
//
// Must be valid:
// `sketch` is NULL or any pointer.
S2pqStatus s2pq_sketch_clear(struct S2pqSketch *sketch);

// Counts what a sketch holds.
//
// Must be valid:
// `stroke_count` and `depth_sample_count` are valid for writing.
S2pqStatus s2pq_sketch_counts(const struct S2pqSketch *sketch, size_t *stroke_count, size_t *depth_sample_count);

// Frees a sketch; NULL is fine.
//
// Must be valid:
// No call uses the sketch.
void s2pq_sketch_free(struct S2pqSketch *sketch);

// Gives every option its default.
//
// - `size`: sizeof(S2pqSurfaceOptions) as the host compiled it.
//
// Must be valid:
// `options` is valid for writing `size` bytes.
S2pqStatus s2pq_surface_options_init(struct S2pqSurfaceOptions *options, size_t size);

// Turns a sketch into a surface: one patch for each outline.
//
// Without depth samples the surface's lowest point has z = 0; with depth samples it passes through them. Moving or
// scaling the strokes moves or scales the result.
//
// - `sketch`: read only.
// - `options`: NULL for the defaults.
// - `surface`: takes the new surface.
// - S2PQ_STATUS_INVALID_SKETCH: the message names the place on the canvas and what to draw there.
// - S2PQ_STATUS_CANCELLED: s2pq_cancel was called, or a newer sketch came to a live session.
//
// Must be valid:
// `options` is NULL or valid as its `struct_size` says; `surface` is valid for writing.
S2pqStatus sketch_to_surface(struct S2pqSession *session,
                             const struct S2pqSketch *sketch,
                             const struct S2pqSurfaceOptions *options,
                             struct S2pqSurface **surface);

// Makes a surface of a host's own NURBS patch, copied; it enters the pipeline at surface_to_cdf.
//
// - `nurbs`: clamped, of degree 1 to 5, rational or not.
// - `surface`: takes the new surface of one patch.
//
// Must be valid:
// `nurbs` is valid as its `struct_size` and counts say; `surface` is valid for writing.
S2pqStatus s2pq_surface_from_nurbs(const struct S2pqNurbs *nurbs, struct S2pqSurface **surface);

// Adds another NURBS patch to a surface made by s2pq_surface_from_nurbs. Views lent before become invalid.
//
// Must be valid:
// `nurbs` is valid as its `struct_size` and counts say.
S2pqStatus s2pq_surface_add_nurbs(struct S2pqSurface *surface, const struct S2pqNurbs *nurbs);

// Number of patches.
//
// Must be valid:
// `count` is valid for writing.
S2pqStatus s2pq_surface_patch_count(const struct S2pqSurface *surface, size_t *count);

// The NURBS data of a patch; its arrays are lent until the surface is freed.
//
// - `nurbs`: set its struct_size first.
//
// Must be valid:
// `nurbs` is valid for writing as many bytes as its `struct_size` says.
S2pqStatus s2pq_surface_nurbs(const struct S2pqSurface *surface, size_t patch, struct S2pqNurbs *nurbs);

// Evaluates a patch at parameters, which are clamped to the domain of its knots.
//
// - `uv`: `count` times u and v.
// - `xyz`: takes `count` times x, y, z, world frame.
// - `normals`: takes `count` unit normals S_u x S_v, zero where there is none; NULL if not wanted.
//
// Must be valid:
// `uv` is valid for reading 2 * `count` numbers, `xyz` and `normals`, unless NULL, for writing 3 * `count`.
S2pqStatus s2pq_surface_evaluate(const struct S2pqSurface *surface,
                                 size_t patch,
                                 const double *uv,
                                 size_t count,
                                 double *xyz,
                                 double *normals);

// A patch as bicubic Bezier patches, one for each span of its knots, exactly. Lent until the surface is freed.
//
// - `xyz`: 16 points for each of count_u * count_v pieces, pieces and points with v running fastest: point (a, b) of piece (i, j) begins
//   at `3 * (16 * (i * count_v + j) + 4 * a + b)`. Degrees 1 and 2 are raised to 3.
// - S2PQ_STATUS_INVALID_GEOMETRY: the patch is rational, or of a degree above 3, which no bicubic patches equal: use s2pq_surface_grid.
//
// Must be valid:
// `xyz`, `count_u` and `count_v` are valid for writing.
S2pqStatus s2pq_surface_bezier(const struct S2pqSurface *surface,
                               size_t patch,
                               const double **xyz,
                               size_t *count_u,
                               size_t *count_v);

// A patch as a grid of points, normals and quads, for drawing: any degree, rational or not. The quads are not planar.
//
// - `cells_u`, `cells_v`: number of equal cells of the parameter domain, at least 1 each, at most 2^24 vertices.
// - `xyz`: takes (cells_u + 1) * (cells_v + 1) times x, y, z, world frame, v running fastest.
// - `normals`: takes as many unit normals S_u x S_v, zero where there is none; NULL if not wanted.
// - `quads`: takes cells_u * cells_v times four vertex indices, counter-clockwise seen from the side of the normals; NULL if not wanted.
//
// Must be valid:
// `xyz`, `normals` and `quads`, unless NULL, are valid for writing as many values.
S2pqStatus s2pq_surface_grid(const struct S2pqSurface *surface,
                             size_t patch,
                             size_t cells_u,
                             size_t cells_v,
                             double *xyz,
                             double *normals,
                             uint32_t *quads);

// How well a patch obeys the sketch.
//
// - `diagnostics`: set its struct_size first.
//
// Must be valid:
// `diagnostics` is valid for writing as many bytes as its `struct_size` says.
S2pqStatus s2pq_surface_diagnostics(const struct S2pqSurface *surface,
                                    size_t patch,
                                    struct S2pqSurfaceDiagnostics *diagnostics);

// Strokes that played no part, by their place in the sketch: too short, or drawn twice. Lent until the surface is
// freed.
//
// Must be valid:
// `strokes` and `count` are valid for writing.
S2pqStatus s2pq_surface_unused_strokes(const struct S2pqSurface *surface, const uint32_t **strokes, size_t *count);

// Measures and times as JSON, UTF-8, NUL-terminated; lent until the surface is freed.
//
// Must be valid:
// `json` and `length` are valid for writing; `length` may be NULL.
S2pqStatus s2pq_surface_report_json(const struct S2pqSurface *surface, const char **json, size_t *length);

// Frees a surface; NULL is fine. Fields made on it stay alive.
//
// Must be valid:
// No call uses the surface or a view of it.
void s2pq_surface_free(struct S2pqSurface *surface);

// Gives every option its default.
//
// - `size`: sizeof(S2pqFieldOptions) as the host compiled it.
//
// Must be valid:
// `options` is valid for writing `size` bytes.
S2pqStatus s2pq_field_options_init(struct S2pqFieldOptions *options, size_t size);

// Finds a conjugate direction field on a surface, aligned with the feature lines of a sketch.
//
// - `sketch`: the sketch that the surface was made from, perhaps with other feature lines; or, for a host's own
//   surface, feature lines drawn over its picture in the sketch's view; or NULL: the surface alone decides.
// - `surface`: read only.
// - `options`: NULL for the defaults.
// - `field`: takes the new field.
//
// Must be valid:
// `options`, and the singularities that it points to, are NULL or valid as their `struct_size` and count say; `field` is valid for writing.
S2pqStatus sketch_to_cdf(struct S2pqSession *session,
                         const struct S2pqSketch *sketch,
                         const struct S2pqSurface *surface,
                         const struct S2pqFieldOptions *options,
                         struct S2pqField **field);

// Finds a conjugate direction field on a surface, e.g. a host's own from s2pq_surface_from_nurbs, aligned with curves in
// space.
//
// - `surface`: read only.
// - `curves`: NULL for none; then, unless sides are aligned, the field is the smoothest one near the principal directions.
// - `options`: NULL for the defaults; no network runs.
// - `field`: takes the new field.
//
// Must be valid:
// `curves`, `options` and the singularities that it points to are NULL or valid as their `struct_size` and counts say; `field` is valid
// for writing.
S2pqStatus surface_to_cdf(struct S2pqSession *session,
                          const struct S2pqSurface *surface,
                          const struct S2pqCurves *curves,
                          const struct S2pqFieldOptions *options,
                          struct S2pqField **field);

// First vertex and first triangle of each patch, `patch_count` + 1 entries each; lent until the field is freed.
//
// The arrays of a field hold its patches one after another.
//
// Must be valid:
// `vertex_starts`, `triangle_starts` and `patch_count` are valid for writing.
S2pqStatus s2pq_field_patches(const struct S2pqField *field,
                              const uint32_t **vertex_starts,
                              const uint32_t **triangle_starts,
                              size_t *patch_count);

// Vertices of the triangulation, `count` times x, y, z, world frame; lent until the field is freed.
//
// Must be valid:
// `xyz` and `count` are valid for writing.
S2pqStatus s2pq_field_vertices(const struct S2pqField *field, const double **xyz, size_t *count);

// Triangles, `count` times three vertex indices, counter-clockwise about S_u x S_v; lent until the field is freed.
//
// Must be valid:
// `indices` and `count` are valid for writing.
S2pqStatus s2pq_field_triangles(const struct S2pqField *field, const uint32_t **indices, size_t *count);

// Directions, for each triangle u then v, unit vectors in its plane, world frame, `count` times six numbers; lent
// until the field is freed.
//
// u and v carry no sign and no order from one triangle to the next: the cross u, v, -u, -v is what continues.
//
// Must be valid:
// `uv` and `count` are valid for writing.
S2pqStatus s2pq_field_directions(const struct S2pqField *field, const double **uv, size_t *count);

// Singular vertices and their indices in quarter turns: +1 where three, -1 where five quads meet; lent until the field
// is freed.
//
// Must be valid:
// `vertices`, `indices` and `count` are valid for writing.
S2pqStatus s2pq_field_singularities(const struct S2pqField *field,
                                    const uint32_t **vertices,
                                    const int32_t **indices,
                                    size_t *count);

// Triangles where a hard curve or an aligned side left no conjugate pair above the smallest crossing angle, so that the
// angle won and the pair is not conjugate; lent until the field is freed.
//
// Must be valid:
// `triangles` and `count` are valid for writing.
S2pqStatus s2pq_field_floor_triangles(const struct S2pqField *field, const uint32_t **triangles, size_t *count);

// How good a field is.
//
// - `diagnostics`: set its struct_size first.
//
// Must be valid:
// `diagnostics` is valid for writing as many bytes as its `struct_size` says.
S2pqStatus s2pq_field_diagnostics(const struct S2pqField *field, struct S2pqFieldDiagnostics *diagnostics);

// Measures and times so far as JSON, UTF-8, NUL-terminated; lent until the field is freed.
//
// Must be valid:
// `json` and `length` are valid for writing; `length` may be NULL.
S2pqStatus s2pq_field_report_json(const struct S2pqField *field, const char **json, size_t *length);

// Frees a field; NULL is fine. Meshes made from it stay alive.
//
// Must be valid:
// No call uses the field or a view of it.
void s2pq_field_free(struct S2pqField *field);

// Gives every option its default.
//
// - `size`: sizeof(S2pqMeshOptions) as the host compiled it.
//
// Must be valid:
// `options` is valid for writing `size` bytes.
S2pqStatus s2pq_mesh_options_init(struct S2pqMeshOptions *options, size_t size);

// Extracts panels along a field and moves their vertices until every panel is planar.
//
// - `field`: read only.
// - `options`: NULL for the defaults.
// - `mesh`: takes the new mesh, all patches one after another.
//
// Must be valid:
// `options` is NULL or valid as its `struct_size` says; `mesh` is valid for writing.
S2pqStatus extract_pq_mesh(struct S2pqSession *session,
                           const struct S2pqField *field,
                           const struct S2pqMeshOptions *options,
                           struct S2pqMesh **mesh);

// First vertex and first face of each patch, `patch_count` + 1 entries each; lent until the mesh is freed.
//
// Must be valid:
// `vertex_starts`, `face_starts` and `patch_count` are valid for writing.
S2pqStatus s2pq_mesh_patches(const struct S2pqMesh *mesh,
                             const uint32_t **vertex_starts,
                             const uint32_t **face_starts,
                             size_t *patch_count);

// Vertices, `count` times x, y, z, world frame (right-handed, z up), canvas unit; lent until the mesh is freed.
//
// Must be valid:
// `xyz` and `count` are valid for writing.
S2pqStatus s2pq_mesh_vertices(const struct S2pqMesh *mesh, const double **xyz, size_t *count);

// Faces: face f has the vertices `indices[starts[f]]` to `indices[starts[f + 1] - 1]`, counter-clockwise seen from the
// surface's front; lent until the mesh is freed.
//
// - `starts`: `count` + 1 entries.
// - `indices`: `starts[count]` entries.
//
// Must be valid:
// `starts`, `indices` and `count` are valid for writing.
S2pqStatus s2pq_mesh_faces(const struct S2pqMesh *mesh,
                           const uint32_t **starts,
                           const uint32_t **indices,
                           size_t *count);

// Planarity of each face: distance of the diagonals' lines over the mesh's mean edge length; lent until the mesh is
// freed.
//
// Must be valid:
// `values` and `count` are valid for writing.
S2pqStatus s2pq_mesh_planarity(const struct S2pqMesh *mesh, const double **values, size_t *count);

// Distance of each vertex from the surface, of border vertices from the surface's border; canvas unit; lent until the
// mesh is freed.
//
// Must be valid:
// `values` and `count` are valid for writing.
S2pqStatus s2pq_mesh_deviation(const struct S2pqMesh *mesh, const double **values, size_t *count);

// For each vertex 1 if it lies on the mesh's border, else 0; lent until the mesh is freed.
//
// Must be valid:
// `flags` and `count` are valid for writing.
S2pqStatus s2pq_mesh_border(const struct S2pqMesh *mesh, const uint8_t **flags, size_t *count);

// Inner vertices where another number than four edges meets; lent until the mesh is freed.
//
// Must be valid:
// `vertices` and `count` are valid for writing.
S2pqStatus s2pq_mesh_irregular_vertices(const struct S2pqMesh *mesh, const uint32_t **vertices, size_t *count);

// Measures of the whole mesh.
//
// - `report`: set its struct_size first.
//
// Must be valid:
// `report` is valid for writing as many bytes as its `struct_size` says.
S2pqStatus s2pq_mesh_report(const struct S2pqMesh *mesh, struct S2pqMeshReport *report);

// The mesh as OBJ text, UTF-8, NUL-terminated; lent until the mesh is freed.
//
// Must be valid:
// `text` and `length` are valid for writing; `length` may be NULL.
S2pqStatus s2pq_mesh_obj(const struct S2pqMesh *mesh, const char **text, size_t *length);

// Measures and times of all stages as JSON, UTF-8, NUL-terminated; lent until the mesh is freed.
//
// Must be valid:
// `json` and `length` are valid for writing; `length` may be NULL.
S2pqStatus s2pq_mesh_report_json(const struct S2pqMesh *mesh, const char **json, size_t *length);

// Frees a mesh; NULL is fine.
//
// Must be valid:
// No call uses the mesh or a view of it.
void s2pq_mesh_free(struct S2pqMesh *mesh);

// Gives every option its default.
//
// - `size`: sizeof(S2pqPlanarizeOptions) as the host compiled it.
//
// Must be valid:
// `options` is valid for writing `size` bytes.
S2pqStatus s2pq_planarize_options_init(struct S2pqPlanarizeOptions *options, size_t size);

// Moves the vertices of a host's own mesh until every face is planar; faces and numbering stay.
//
// - `polygons`: quads or any polygons, of three and more corners.
// - `surface`: a surface of one patch to stay on; NULL: the mesh stays close to itself as it is given.
// - `options`: NULL for the defaults.
// - `mesh`: takes the new mesh: one patch.
//
// Must be valid:
// `polygons` is valid as its fields say; `options` is NULL or valid as its `struct_size` says; `mesh` is valid for
// writing.
S2pqStatus s2pq_planarize(struct S2pqSession *session,
                          const struct S2pqPolygons *polygons,
                          const struct S2pqSurface *surface,
                          const struct S2pqPlanarizeOptions *options,
                          struct S2pqMesh **mesh);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* SKETCH2PQ_H */
