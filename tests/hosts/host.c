/* What a C host may do to the library, right and wrong. Built by tests/hosts/run with the address and undefined-behaviour sanitizers.
 *
 * usage: host SKETCH.json
 */
#include "sketch2pq.h"
#include <math.h>
#include <pthread.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef S2PQ_HOST_TESTS
S2pqStatus s2pq_test_panic(void);
#endif

static int failures = 0;

#define CHECK(condition)                                                                   \
  do {                                                                                     \
    if (!(condition)) {                                                                    \
      char text_[512];                                                                     \
      s2pq_last_message(text_, sizeof text_);                                              \
      fprintf(stderr, "host.c:%d: %s (last message: %s)\n", __LINE__, #condition, text_); \
      failures++;                                                                          \
    }                                                                                      \
  } while (0)

/* Layout: what bindings in other languages repeat. */
#define LAYOUT(type, size) _Static_assert(sizeof(void *) != 8 || sizeof(type) == (size), #type)
#define OFFSET(type, field, offset) \
  _Static_assert(sizeof(void *) != 8 || offsetof(type, field) == (offset), #type "." #field)
LAYOUT(S2pqSessionOptions, 32);
OFFSET(S2pqSessionOptions, backend, 4);
OFFSET(S2pqSessionOptions, threads, 8);
OFFSET(S2pqSessionOptions, live, 12);
OFFSET(S2pqSessionOptions, runtime_path, 16);
OFFSET(S2pqSessionOptions, models_folder, 24);
LAYOUT(S2pqSurfaceOptions, 24);
OFFSET(S2pqSurfaceOptions, corners, 8);
OFFSET(S2pqSurfaceOptions, fairness, 16);
LAYOUT(S2pqNurbs, 80);
OFFSET(S2pqNurbs, degree_u, 4);
OFFSET(S2pqNurbs, count_u, 16);
OFFSET(S2pqNurbs, knot_count_u, 32);
OFFSET(S2pqNurbs, knots_u, 48);
OFFSET(S2pqNurbs, control_points, 64);
OFFSET(S2pqNurbs, weights, 72);
LAYOUT(S2pqSurfaceDiagnostics, 48);
OFFSET(S2pqSurfaceDiagnostics, reprojection_mean_px, 8);
OFFSET(S2pqSurfaceDiagnostics, misfacing, 32);
OFFSET(S2pqSurfaceDiagnostics, warm_start, 40);
LAYOUT(S2pqSingularities, 48);
OFFSET(S2pqSingularities, count, 8);
OFFSET(S2pqSingularities, points, 16);
OFFSET(S2pqSingularities, indices, 40);
LAYOUT(S2pqFieldOptions, 48);
OFFSET(S2pqFieldOptions, use_network, 4);
OFFSET(S2pqFieldOptions, crossing_floor_deg, 16);
OFFSET(S2pqFieldOptions, singularities, 24);
OFFSET(S2pqFieldOptions, edge_length, 32);
OFFSET(S2pqFieldOptions, faces, 40);
LAYOUT(S2pqCurves, 40);
OFFSET(S2pqCurves, curve_count, 8);
OFFSET(S2pqCurves, starts, 16);
OFFSET(S2pqCurves, points, 24);
OFFSET(S2pqCurves, hard, 32);
LAYOUT(S2pqFieldDiagnostics, 40);
OFFSET(S2pqFieldDiagnostics, singularities, 4);
OFFSET(S2pqFieldDiagnostics, feature_angle_deg, 32);
LAYOUT(S2pqMeshOptions, 40);
OFFSET(S2pqMeshOptions, border, 4);
OFFSET(S2pqMeshOptions, edge_length, 16);
OFFSET(S2pqMeshOptions, planarity, 24);
OFFSET(S2pqMeshOptions, hold, 36);
LAYOUT(S2pqPolygons, 64);
OFFSET(S2pqPolygons, vertex_count, 8);
OFFSET(S2pqPolygons, pins, 56);
LAYOUT(S2pqPlanarizeOptions, 56);
OFFSET(S2pqPlanarizeOptions, strict, 12);
OFFSET(S2pqPlanarizeOptions, fairness, 40);
OFFSET(S2pqPlanarizeOptions, anchor, 48);
LAYOUT(S2pqMeshReport, 88);
OFFSET(S2pqMeshReport, faces, 4);
OFFSET(S2pqMeshReport, planarity_max, 16);
OFFSET(S2pqMeshReport, time_ms, 64);
OFFSET(S2pqMeshReport, border_deviation_widths, 80);

static char *read_file(const char *path, size_t *length) {
  FILE *file = fopen(path, "rb");
  char *text = NULL;
  long size;
  if (file == NULL || fseek(file, 0, SEEK_END) != 0 || (size = ftell(file)) < 0) {
    fprintf(stderr, "%s: cannot be read\n", path);
    exit(2);
  }
  rewind(file);
  text = malloc((size_t)size + 1);
  *length = fread(text, 1, (size_t)size, file);
  fclose(file);
  return text;
}

static void versions(void) {
  char small[4] = "xyz";
  CHECK(s2pq_abi_version() == S2PQ_ABI_VERSION);
  CHECK(strlen(s2pq_version()) >= 5);
  CHECK(strcmp(s2pq_status_name(S2PQ_STATUS_OK), "ok") == 0);
  CHECK(strcmp(s2pq_status_name(1000), "unknown status") == 0);
  CHECK(s2pq_sketch_clear(NULL) == S2PQ_STATUS_INVALID_ARGUMENT);
  CHECK(s2pq_last_message(NULL, 0) > 10);
  CHECK(s2pq_last_message(small, sizeof small) > 10 && strlen(small) == 3);
}

/* NULL, stray, foreign and freed handles. */
static void bad_pointers(S2pqSession *session) {
  S2pqSketch *sketch = NULL;
  S2pqSurface *surface = NULL;
  S2pqField *field = NULL;
  S2pqMesh *mesh = NULL;
  const double *numbers;
  size_t count;
  CHECK(s2pq_sketch_new(NULL) == S2PQ_STATUS_INVALID_ARGUMENT);
  CHECK(s2pq_sketch_new(&sketch) == S2PQ_STATUS_OK);
  CHECK(s2pq_sketch_add_stroke(sketch, 0, NULL, 5) == S2PQ_STATUS_INVALID_ARGUMENT);
  CHECK(s2pq_sketch_add_stroke(sketch, 0, NULL, SIZE_MAX) == S2PQ_STATUS_INVALID_SKETCH);
  CHECK(s2pq_sketch_set_view_axes(sketch, NULL, 0) == S2PQ_STATUS_INVALID_ARGUMENT);
  CHECK(s2pq_sketch_set_view_angles(sketch, 0, 91, 0) == S2PQ_STATUS_INVALID_ARGUMENT);
  CHECK(s2pq_sketch_set_view_angles(sketch, 0, 45, 2) == S2PQ_STATUS_INVALID_ARGUMENT);
  CHECK(s2pq_sketch_from_json(NULL, 5, &sketch) == S2PQ_STATUS_INVALID_ARGUMENT);
  CHECK(s2pq_sketch_from_svg(NULL, 5, &sketch) == S2PQ_STATUS_INVALID_ARGUMENT);
  CHECK(sketch_to_surface(NULL, sketch, NULL, &surface) == S2PQ_STATUS_INVALID_ARGUMENT);
  CHECK(sketch_to_surface(session, NULL, NULL, &surface) == S2PQ_STATUS_INVALID_ARGUMENT);
  CHECK(sketch_to_surface(session, sketch, NULL, NULL) == S2PQ_STATUS_INVALID_ARGUMENT);
  CHECK(sketch_to_surface(session, (S2pqSketch *)(void *)session, NULL, &surface) == S2PQ_STATUS_INVALID_ARGUMENT);
  CHECK(sketch_to_surface((S2pqSession *)(void *)16, sketch, NULL, &surface) == S2PQ_STATUS_INVALID_ARGUMENT);
  CHECK(sketch_to_cdf(session, sketch, NULL, NULL, &field) == S2PQ_STATUS_INVALID_ARGUMENT);
  CHECK(extract_pq_mesh(session, NULL, NULL, &mesh) == S2PQ_STATUS_INVALID_ARGUMENT);
  CHECK(s2pq_mesh_vertices(NULL, &numbers, &count) == S2PQ_STATUS_INVALID_ARGUMENT);
  CHECK(s2pq_cancel(NULL) == S2PQ_STATUS_INVALID_ARGUMENT);
  CHECK(s2pq_surface_from_nurbs(NULL, &surface) == S2PQ_STATUS_INVALID_ARGUMENT);
  CHECK(surface == NULL && field == NULL && mesh == NULL);
  s2pq_sketch_free(sketch);
  CHECK(s2pq_sketch_clear(sketch) == S2PQ_STATUS_INVALID_ARGUMENT);
  s2pq_sketch_free(sketch);
  s2pq_sketch_free(NULL);
  s2pq_session_free(NULL);
  s2pq_surface_free(NULL);
  s2pq_field_free(NULL);
  s2pq_mesh_free(NULL);
}

/* Hosts compiled against older and newer headers. */
static void struct_sizes(S2pqSession *session, const S2pqField *field) {
  struct {
    S2pqMeshOptions known;
    double unknown[2];
  } newer;
  struct {
    uint32_t struct_size, border;
    uint64_t guard;
  } old;
  S2pqMeshReport report;
  S2pqMesh *mesh = NULL;
  memset(&newer, 0xAA, sizeof newer);
  CHECK(s2pq_mesh_options_init(&newer.known, sizeof newer) == S2PQ_STATUS_OK);
  CHECK(newer.known.struct_size == sizeof newer && newer.unknown[0] == 0 && newer.unknown[1] == 0);
  CHECK(newer.known.planarity > 0 && newer.known.faces == 500);
  newer.known.faces = 60;
  CHECK(extract_pq_mesh(session, field, &newer.known, &mesh) == S2PQ_STATUS_OK);
  s2pq_mesh_free(mesh);
  mesh = NULL;
  newer.unknown[1] = 1;
  CHECK(extract_pq_mesh(session, field, &newer.known, &mesh) == S2PQ_STATUS_INVALID_ARGUMENT && mesh == NULL);

  old.guard = 0x1234;
  CHECK(s2pq_mesh_options_init((S2pqMeshOptions *)(void *)&old, 8) == S2PQ_STATUS_OK);
  CHECK(old.struct_size == 8 && old.guard == 0x1234);
  old.border = 77;
  CHECK(extract_pq_mesh(session, field, (S2pqMeshOptions *)(void *)&old, &mesh) == S2PQ_STATUS_INVALID_ARGUMENT);
  old.struct_size = 0;
  CHECK(extract_pq_mesh(session, field, (S2pqMeshOptions *)(void *)&old, &mesh) == S2PQ_STATUS_INVALID_ARGUMENT);
  CHECK(s2pq_mesh_options_init(NULL, 32) == S2PQ_STATUS_INVALID_ARGUMENT);
  CHECK(s2pq_mesh_options_init(&newer.known, 4) == S2PQ_STATUS_INVALID_ARGUMENT);

  old.struct_size = 8;
  old.border = S2PQ_BORDER_TRIMMED;
  CHECK(extract_pq_mesh(session, field, (S2pqMeshOptions *)(void *)&old, &mesh) == S2PQ_STATUS_OK);
  memset(&report, 0xAA, sizeof report);
  report.struct_size = 16;
  CHECK(s2pq_mesh_report(mesh, &report) == S2PQ_STATUS_OK);
  CHECK(report.struct_size == 16 && report.faces > 100 && report.planarity_max < 0);
  report.struct_size = 0;
  CHECK(s2pq_mesh_report(mesh, &report) == S2PQ_STATUS_INVALID_ARGUMENT);
  s2pq_mesh_free(mesh);
}

/* The broken sketches that every door has to survive: a clear error, or a correct result. */
static void broken_sketches(S2pqSession *session) {
  static const double square[] = {40, 60, 90, 60, 140, 60, 200, 60, 200, 100, 200, 150, 200, 200,
                                  150, 200, 100, 200, 40, 200, 40, 150, 40, 100, 40, 60};
  static const double eight[] = {40, 60, 200, 200, 200, 60, 40, 200, 40, 60};
  S2pqSurface *surface = NULL;
  S2pqSketch *sketch = NULL;
  double one[] = {3, 4}, scaled[26], bad[] = {40, 60, NAN, 60, 200, 200};
  double *many = malloc(2000000 * sizeof *many);
  size_t i, strokes, samples;
  int k;
  CHECK(s2pq_sketch_new(&sketch) == S2PQ_STATUS_OK);

  /* empty, one point, not a number */
  CHECK(sketch_to_surface(session, sketch, NULL, &surface) == S2PQ_STATUS_INVALID_SKETCH);
  CHECK(s2pq_sketch_add_stroke(sketch, 0, one, 1) == S2PQ_STATUS_OK);
  CHECK(sketch_to_surface(session, sketch, NULL, &surface) == S2PQ_STATUS_INVALID_SKETCH);
  CHECK(s2pq_sketch_clear(sketch) == S2PQ_STATUS_OK);
  CHECK(s2pq_sketch_add_stroke(sketch, 0, bad, 3) == S2PQ_STATUS_INVALID_SKETCH);
  CHECK(s2pq_sketch_add_depth_sample(sketch, 0, 1, 2, INFINITY) == S2PQ_STATUS_INVALID_SKETCH);
  CHECK(s2pq_sketch_add_depth_sample(sketch, 2, 1, 2, 3) == S2PQ_STATUS_INVALID_ARGUMENT);
  CHECK(s2pq_sketch_counts(sketch, &strokes, &samples) == S2PQ_STATUS_OK && strokes == 0 && samples == 0);

  /* open outline, self-crossing outline, only feature lines */
  CHECK(s2pq_sketch_add_stroke(sketch, 0, square, 9) == S2PQ_STATUS_OK);
  CHECK(sketch_to_surface(session, sketch, NULL, &surface) == S2PQ_STATUS_INVALID_SKETCH);
  s2pq_sketch_clear(sketch);
  s2pq_sketch_add_stroke(sketch, 0, eight, 5);
  CHECK(sketch_to_surface(session, sketch, NULL, &surface) == S2PQ_STATUS_INVALID_SKETCH || surface != NULL);
  s2pq_surface_free(surface);
  surface = NULL;
  s2pq_sketch_clear(sketch);
  s2pq_sketch_add_stroke(sketch, 3, square, 13);
  CHECK(sketch_to_surface(session, sketch, NULL, &surface) == S2PQ_STATUS_INVALID_SKETCH);

  /* a million points */
  s2pq_sketch_clear(sketch);
  for (i = 0; i < 1000000; i++) {
    double angle = 6.283185307179586 * (double)i / 999999.0;
    many[2 * i] = 128 + 90 * cos(angle);
    many[2 * i + 1] = 128 + 70 * sin(angle);
  }
  if (s2pq_sketch_add_stroke(sketch, 0, many, 1000000) == S2PQ_STATUS_OK) {
    CHECK(sketch_to_surface(session, sketch, NULL, &surface) == S2PQ_STATUS_OK);
    s2pq_surface_free(surface);
    surface = NULL;
  } else {
    CHECK(s2pq_last_message(NULL, 0) > 10);
  }

  /* huge and tiny coordinates: a result, or an error that says so; unknown kind; strokes drawn twice */
  for (k = 0; k < 4; k++) {
    static const double scales[] = {1e12, 1e-12, 1e300, 1e-300};
    S2pqStatus status;
    for (i = 0; i < 26; i++) scaled[i] = square[i] * scales[k];
    s2pq_sketch_clear(sketch);
    s2pq_sketch_add_stroke(sketch, 0, scaled, 13);
    status = sketch_to_surface(session, sketch, NULL, &surface);
    CHECK(status == S2PQ_STATUS_OK || (k >= 2 && status != S2PQ_STATUS_INTERNAL));
    s2pq_surface_free(surface);
    surface = NULL;
  }
  s2pq_sketch_clear(sketch);
  CHECK(s2pq_sketch_add_stroke(sketch, 4, square, 13) == S2PQ_STATUS_INVALID_ARGUMENT);
  s2pq_sketch_add_stroke(sketch, 0, square, 13);
  s2pq_sketch_add_stroke(sketch, 0, square, 13);
  CHECK(sketch_to_surface(session, sketch, NULL, &surface) == S2PQ_STATUS_OK);
  s2pq_surface_free(surface);
  s2pq_sketch_free(sketch);
  free(many);
}

/* Progress on the calling thread, cancel from within it and from another thread. */
typedef struct Watch {
  S2pqSession *session;
  pthread_t thread;
  int calls, foreign, busy;
  int cancel_at;
} Watch;

static void watch(void *user, const char *stage, double fraction) {
  Watch *w = user;
  S2pqSketch *sketch = NULL;
  S2pqSurface *surface = NULL;
  w->calls++;
  w->foreign += !pthread_equal(w->thread, pthread_self()) || stage[0] == 0 || !(fraction >= 0 && fraction <= 1);
  if (w->calls == 1) {
    s2pq_sketch_new(&sketch);
    w->busy = sketch_to_surface(w->session, sketch, NULL, &surface) == S2PQ_STATUS_INVALID_ARGUMENT;
    s2pq_sketch_free(sketch);
  }
  if (w->calls == w->cancel_at) s2pq_cancel(w->session);
}

static void *cancel_soon(void *session) {
  s2pq_cancel(session);
  return NULL;
}

static void progress_and_cancel(S2pqSession *session, const S2pqSketch *sketch) {
  Watch w = {session, pthread_self(), 0, 0, 0, 0};
  S2pqSurface *surface = NULL;
  pthread_t other;
  CHECK(s2pq_session_set_progress(session, watch, &w) == S2PQ_STATUS_OK);
  CHECK(sketch_to_surface(session, sketch, NULL, &surface) == S2PQ_STATUS_OK);
  CHECK(w.calls > 2 && w.foreign == 0 && w.busy);
  s2pq_surface_free(surface);
  surface = NULL;
  w.calls = 1;
  w.cancel_at = 2;
  CHECK(sketch_to_surface(session, sketch, NULL, &surface) == S2PQ_STATUS_CANCELLED && surface == NULL);
  CHECK(s2pq_session_set_progress(session, NULL, NULL) == S2PQ_STATUS_OK);

  CHECK(pthread_create(&other, NULL, cancel_soon, session) == 0);
  pthread_join(other, NULL);
  CHECK(sketch_to_surface(session, sketch, NULL, &surface) == S2PQ_STATUS_CANCELLED && surface == NULL);
  s2pq_cancel(session);
  s2pq_cancel_reset(session);
  CHECK(sketch_to_surface(session, sketch, NULL, &surface) == S2PQ_STATUS_OK && surface != NULL);
  s2pq_surface_free(surface);
}

/* A helix and a ruling on the quarter cylinder: the field follows them, and broken curves are refused. */
/* What a pen does: the same sketch again and again, each in its own handle. */
typedef struct {
  S2pqSession *session;
  const char *json;
  size_t length;
  int status;
  int finished;
} Stroke;

static void *draw(void *argument) {
  Stroke *stroke = argument;
  S2pqSketch *sketch = NULL;
  S2pqSurface *surface = NULL;
  CHECK(s2pq_sketch_from_json((const uint8_t *)stroke->json, stroke->length, &sketch) == S2PQ_STATUS_OK);
  stroke->status = (int)sketch_to_surface(stroke->session, sketch, NULL, &surface);
  stroke->finished = surface != NULL;
  s2pq_surface_free(surface);
  s2pq_sketch_free(sketch);
  return NULL;
}

/* A newer sketch stops the older call, and the one after a finished one begins with its surface. */
static void live(const char *json, size_t length) {
  S2pqSessionOptions options;
  S2pqSession *session = NULL;
  S2pqSketch *sketch = NULL;
  S2pqSurface *surface = NULL;
  S2pqSurfaceDiagnostics diagnostics;
  Stroke strokes[4];
  pthread_t pens[4];
  int i, finished = 0;
  CHECK(s2pq_session_options_init(&options, sizeof options) == S2PQ_STATUS_OK && options.live == 0);
  options.backend = S2PQ_BACKEND_EMBEDDED;
  options.threads = 1;
  options.live = 2;
  CHECK(s2pq_session_new(&options, &session) == S2PQ_STATUS_INVALID_ARGUMENT && session == NULL);
  options.live = 1;
  CHECK(s2pq_session_new(&options, &session) == S2PQ_STATUS_OK);
  for (i = 0; i < 4; i++) {
    Stroke stroke = {session, json, length, -1, 0};
    strokes[i] = stroke;
    CHECK(pthread_create(&pens[i], NULL, draw, &strokes[i]) == 0);
  }
  for (i = 0; i < 4; i++) pthread_join(pens[i], NULL);
  for (i = 0; i < 4; i++) {
    CHECK(strokes[i].status == S2PQ_STATUS_OK || strokes[i].status == S2PQ_STATUS_CANCELLED);
    CHECK(strokes[i].finished == (strokes[i].status == S2PQ_STATUS_OK));
    finished += strokes[i].finished;
  }
  CHECK(finished >= 1);
  CHECK(s2pq_sketch_from_json((const uint8_t *)json, length, &sketch) == S2PQ_STATUS_OK);
  CHECK(sketch_to_surface(session, sketch, NULL, &surface) == S2PQ_STATUS_OK);
  diagnostics.struct_size = sizeof diagnostics;
  CHECK(s2pq_surface_diagnostics(surface, 0, &diagnostics) == S2PQ_STATUS_OK && diagnostics.warm_start == 1);
  CHECK(diagnostics.reprojection_mean_px < 0.5);
  s2pq_surface_free(surface);
  s2pq_sketch_free(sketch);
  s2pq_session_free(session);
}

/* Bezier patches and a grid agree with the surface at the corners that they share. */
static void preview(const S2pqSurface *surface) {
  const double *bezier = NULL;
  double corners[8] = {0, 0, 0, 1, 1, 0, 1, 1}, at[12], xyz[3 * 12], normals[3 * 12];
  uint32_t quads[4 * 6];
  size_t u = 0, v = 0, last, i;
  CHECK(s2pq_surface_bezier(surface, 0, &bezier, &u, &v) == S2PQ_STATUS_OK && u == 27 && v == 27);
  CHECK(s2pq_surface_evaluate(surface, 0, corners, 4, at, NULL) == S2PQ_STATUS_OK);
  last = 3 * (16 * u * v - 1);
  CHECK(s2pq_surface_grid(surface, 0, 2, 3, xyz, normals, quads) == S2PQ_STATUS_OK);
  for (i = 0; i < 3; i++) {
    CHECK(fabs(bezier[i] - at[i]) < 1e-9 && fabs(bezier[last + i] - at[9 + i]) < 1e-9);
    CHECK(fabs(xyz[i] - at[i]) < 1e-9 && fabs(xyz[9 + i] - at[3 + i]) < 1e-9 && fabs(xyz[33 + i] - at[9 + i]) < 1e-9);
  }
  for (i = 0; i < 24; i++) CHECK(quads[i] < 12);
  for (i = 0; i < 12; i++) {
    const double *n = normals + 3 * i;
    CHECK(fabs(n[0] * n[0] + n[1] * n[1] + n[2] * n[2] - 1) < 1e-9);
  }
  CHECK(s2pq_surface_grid(surface, 0, 2, 3, xyz, NULL, NULL) == S2PQ_STATUS_OK);
  CHECK(s2pq_surface_grid(surface, 0, 0, 3, xyz, NULL, NULL) == S2PQ_STATUS_INVALID_ARGUMENT);
  CHECK(s2pq_surface_grid(surface, 0, 2, 3, NULL, NULL, NULL) == S2PQ_STATUS_INVALID_ARGUMENT);
  CHECK(s2pq_surface_bezier(surface, 1, &bezier, &u, &v) == S2PQ_STATUS_INVALID_ARGUMENT);
  CHECK(s2pq_surface_bezier(surface, 0, NULL, &u, &v) == S2PQ_STATUS_INVALID_ARGUMENT);
}

static void feature_curves(S2pqSession *session, S2pqSurface *surface) {
  double points[3 * 12];
  const uint32_t starts[] = {0, 10, 12};
  const uint8_t hard[] = {1, 0};
  const double places[] = {0.92, 0.39, 0.6, 0.45, 0.89, 1.4};
  const int32_t indices[] = {1, -1};
  S2pqCurves curves = {.struct_size = sizeof curves, .curve_count = 2, .starts = starts, .points = points, .hard = hard};
  S2pqSingularities singularities = {.struct_size = sizeof singularities};
  S2pqFieldOptions options;
  S2pqFieldDiagnostics diagnostics = {.struct_size = sizeof diagnostics};
  S2pqField *field = NULL;
  const uint32_t *triangles, *vertices;
  const int32_t *found;
  size_t count = 9;
  int i;
  for (i = 0; i < 10; i++) {
    points[3 * i] = cos(0.15 * i + 0.1);
    points[3 * i + 1] = sin(0.15 * i + 0.1);
    points[3 * i + 2] = 0.3 + 0.1 * i;
  }
  for (i = 10; i < 12; i++) {
    points[3 * i] = cos(0.4);
    points[3 * i + 1] = sin(0.4);
    points[3 * i + 2] = i - 10 ? 1.9 : 1.0;
  }
  CHECK(s2pq_field_options_init(&options, sizeof options) == S2PQ_STATUS_OK);
  CHECK(surface_to_cdf(session, surface, &curves, &options, &field) == S2PQ_STATUS_OK);
  CHECK(s2pq_field_diagnostics(field, &diagnostics) == S2PQ_STATUS_OK && diagnostics.feature_angle_deg < 1);
  CHECK(s2pq_field_floor_triangles(field, &triangles, &count) == S2PQ_STATUS_OK && count == 0);
  s2pq_field_free(field);
  field = NULL;
  options.align_border = 2 + 16;
  CHECK(surface_to_cdf(session, surface, NULL, &options, &field) == S2PQ_STATUS_OK);
  s2pq_field_free(field);
  field = NULL;
  singularities.count = 2;
  singularities.points = places;
  singularities.indices = indices;
  options.singularities = &singularities;
  CHECK(surface_to_cdf(session, surface, NULL, &options, &field) == S2PQ_STATUS_OK);
  CHECK(s2pq_field_singularities(field, &vertices, &found, &count) == S2PQ_STATUS_OK && count == 2);
  CHECK(found[0] + found[1] == 0);
  s2pq_field_free(field);
  field = NULL;
  singularities.count = 1;
  options.align_border = 1;
  CHECK(surface_to_cdf(session, surface, NULL, &options, &field) == S2PQ_STATUS_INVALID_ARGUMENT);
  options.align_border = 0;
  singularities.parameters = places;
  CHECK(surface_to_cdf(session, surface, NULL, &options, &field) == S2PQ_STATUS_INVALID_ARGUMENT);
  options.singularities = NULL;
  options.align_border = 3;
  CHECK(surface_to_cdf(session, surface, NULL, &options, &field) == S2PQ_STATUS_INVALID_ARGUMENT);
  points[4] = NAN;
  CHECK(surface_to_cdf(session, surface, &curves, NULL, &field) == S2PQ_STATUS_INVALID_ARGUMENT);
  points[4] = 1e6;
  CHECK(surface_to_cdf(session, surface, &curves, NULL, &field) == S2PQ_STATUS_INVALID_ARGUMENT);
  curves.points = NULL;
  CHECK(surface_to_cdf(session, surface, &curves, NULL, &field) == S2PQ_STATUS_INVALID_ARGUMENT);
  curves.curve_count = UINT64_MAX;
  CHECK(surface_to_cdf(session, surface, &curves, NULL, &field) == S2PQ_STATUS_INVALID_ARGUMENT);
  curves.struct_size = 0;
  CHECK(surface_to_cdf(session, surface, &curves, NULL, &field) == S2PQ_STATUS_INVALID_ARGUMENT);
  CHECK(surface_to_cdf(session, NULL, NULL, NULL, &field) == S2PQ_STATUS_INVALID_ARGUMENT && field == NULL);
}

/* A host's own quad, made planar; then what must not be taken. */
static void own_panels(S2pqSession *session) {
  double xyz[15] = {1, 0, 0.1, 0, 1, -0.1, -1, 0, 0.1, 0, -1, -0.1, 0.5, 2, 0};
  uint32_t starts[3] = {0, 4, 7}, indices[7] = {0, 1, 2, 3, 0, 4, 1}, pin = 1;
  S2pqPolygons polygons = {.struct_size = sizeof polygons,
                           .vertex_count = 5,
                           .face_count = 2,
                           .pin_count = 1,
                           .vertices = xyz,
                           .starts = starts,
                           .indices = indices,
                           .pins = &pin};
  S2pqPlanarizeOptions options;
  S2pqMesh *mesh = NULL;
  const double *values;
  size_t count;
  CHECK(s2pq_planarize_options_init(&options, sizeof options) == S2PQ_STATUS_OK);
  options.hold = S2PQ_HOLD_FREE;
  options.deviation = 1;
  CHECK(s2pq_planarize(session, &polygons, NULL, &options, &mesh) == S2PQ_STATUS_OK);
  CHECK(s2pq_mesh_planarity(mesh, &values, &count) == S2PQ_STATUS_OK && count == 2 && values[0] < 1e-9);
  CHECK(s2pq_mesh_vertices(mesh, &values, &count) == S2PQ_STATUS_OK && count == 5);
  CHECK(values[3] == 0 && values[4] == 1 && values[5] == -0.1);
  CHECK(s2pq_mesh_deviation(mesh, &values, &count) == S2PQ_STATUS_OK && count == 5 && values[1] == 0);
  s2pq_mesh_free(mesh);
  mesh = NULL;
  pin = 5;
  CHECK(s2pq_planarize(session, &polygons, NULL, &options, &mesh) == S2PQ_STATUS_INVALID_ARGUMENT);
  pin = 1;
  options.hold = 3;
  CHECK(s2pq_planarize(session, &polygons, NULL, &options, &mesh) == S2PQ_STATUS_INVALID_ARGUMENT);
  options.hold = S2PQ_HOLD_FREE;
  options.anchor = 0;
  CHECK(s2pq_planarize(session, &polygons, NULL, &options, &mesh) == S2PQ_STATUS_INVALID_ARGUMENT);
  options.anchor = 100;
  CHECK(s2pq_planarize(session, &polygons, NULL, &options, &mesh) == S2PQ_STATUS_OK);
  s2pq_mesh_free(mesh);
  mesh = NULL;
  starts[1] = 8;
  CHECK(s2pq_planarize(session, &polygons, NULL, NULL, &mesh) == S2PQ_STATUS_INVALID_ARGUMENT);
  starts[1] = 5;
  CHECK(s2pq_planarize(session, &polygons, NULL, NULL, &mesh) == S2PQ_STATUS_INVALID_GEOMETRY);
  polygons.vertices = NULL;
  CHECK(s2pq_planarize(session, &polygons, NULL, NULL, &mesh) == S2PQ_STATUS_INVALID_ARGUMENT);
  CHECK(s2pq_planarize(session, NULL, NULL, NULL, &mesh) == S2PQ_STATUS_INVALID_ARGUMENT);
  CHECK(s2pq_planarize(NULL, &polygons, NULL, NULL, &mesh) == S2PQ_STATUS_INVALID_ARGUMENT);
  CHECK(mesh == NULL);
}

/* A host's own surface: a rational quarter of a cylinder, in both conventions of knots. */
static void own_surface(S2pqSession *session) {
  const double h = 0.70710678118654752;
  const double knots_u[] = {0, 0, 0, 1, 1, 1}, knots_v[] = {0, 0, 1, 1};
  const double net[] = {1, 0, 0, 1, 0, 2, 1, 1, 0, 1, 1, 2, 0, 1, 0, 0, 1, 2};
  const double weights[] = {1, 1, h, h, 1, 1};
  const double uv[] = {0, 0, 0.5, 0.5, 1, 1, -3, 7};
  double xyz[12], normals[12];
  S2pqNurbs nurbs = {.struct_size = sizeof nurbs,
                     .degree_u = 2,
                     .degree_v = 1,
                     .count_u = 3,
                     .count_v = 2,
                     .knot_count_u = 6,
                     .knot_count_v = 4,
                     .knots_u = knots_u,
                     .knots_v = knots_v,
                     .control_points = net,
                     .weights = weights};
  S2pqNurbs view = {.struct_size = sizeof view};
  S2pqSurface *surface = NULL;
  S2pqField *field = NULL;
  S2pqMesh *mesh = NULL;
  size_t count = 0;
  int i;
  CHECK(s2pq_surface_from_nurbs(&nurbs, &surface) == S2PQ_STATUS_OK);
  CHECK(s2pq_surface_patch_count(surface, &count) == S2PQ_STATUS_OK && count == 1);
  CHECK(s2pq_surface_nurbs(surface, 0, &view) == S2PQ_STATUS_OK && view.knot_count_u == 6 && view.weights[2] == h);
  CHECK(s2pq_surface_nurbs(surface, 1, &view) == S2PQ_STATUS_INVALID_ARGUMENT);
  CHECK(s2pq_surface_evaluate(surface, 0, uv, 4, xyz, normals) == S2PQ_STATUS_OK);
  for (i = 0; i < 4; i++) CHECK(fabs(hypot(xyz[3 * i], xyz[3 * i + 1]) - 1) < 1e-12);
  CHECK(s2pq_surface_evaluate(surface, 0, uv, 4, NULL, NULL) == S2PQ_STATUS_INVALID_ARGUMENT);
  CHECK(sketch_to_cdf(session, NULL, surface, NULL, &field) == S2PQ_STATUS_OK);
  s2pq_field_free(field);
  field = NULL;
  feature_curves(session, surface);
  CHECK(surface_to_cdf(session, surface, NULL, NULL, &field) == S2PQ_STATUS_OK);
  s2pq_surface_free(surface);
  CHECK(extract_pq_mesh(session, field, NULL, &mesh) == S2PQ_STATUS_OK);
  s2pq_field_free(field);
  CHECK(s2pq_mesh_vertices(mesh, &view.control_points, &count) == S2PQ_STATUS_OK && count > 100);
  s2pq_mesh_free(mesh);

  nurbs.knots_u = knots_u + 1;
  nurbs.knots_v = knots_v + 1;
  nurbs.knot_count_u = 4;
  nurbs.knot_count_v = 2;
  CHECK(s2pq_surface_from_nurbs(&nurbs, &surface) == S2PQ_STATUS_OK);
  CHECK(s2pq_surface_add_nurbs(surface, &nurbs) == S2PQ_STATUS_OK);
  CHECK(s2pq_surface_patch_count(surface, &count) == S2PQ_STATUS_OK && count == 2);
  s2pq_surface_free(surface);
  surface = NULL;
  nurbs.knot_count_u = 5;
  CHECK(s2pq_surface_from_nurbs(&nurbs, &surface) == S2PQ_STATUS_INVALID_GEOMETRY);
  nurbs.count_u = UINT64_MAX;
  CHECK(s2pq_surface_from_nurbs(&nurbs, &surface) == S2PQ_STATUS_INVALID_GEOMETRY);
  nurbs.knot_count_u = UINT64_MAX;
  CHECK(s2pq_surface_from_nurbs(&nurbs, &surface) == S2PQ_STATUS_INVALID_ARGUMENT && surface == NULL);
}

int main(int argc, char **argv) {
  S2pqSessionOptions options;
  S2pqSession *session = NULL;
  S2pqSketch *sketch = NULL;
  S2pqSurface *surface = NULL;
  S2pqField *field = NULL;
  S2pqMesh *mesh = NULL;
  const uint32_t *starts, *indices;
  const char *text;
  size_t length, faces, i;
  char *json;
  if (argc != 2) return 2;
  json = read_file(argv[1], &length);
  versions();

  CHECK(s2pq_session_options_init(&options, sizeof options) == S2PQ_STATUS_OK);
  options.backend = 9;
  CHECK(s2pq_session_new(&options, &session) == S2PQ_STATUS_INVALID_ARGUMENT && session == NULL);
  options.backend = S2PQ_BACKEND_EMBEDDED;
  options.models_folder = "/nonexistent";
  CHECK(s2pq_session_new(&options, &session) == S2PQ_STATUS_UNAVAILABLE && session == NULL);
  options.models_folder = NULL;
  options.threads = 2;
  CHECK(s2pq_session_new(&options, &session) == S2PQ_STATUS_OK);
  CHECK(s2pq_session_backend(session, &text) == S2PQ_STATUS_OK && strstr(text, "rten") != NULL);
#ifdef S2PQ_HOST_TESTS
  CHECK(s2pq_test_panic() == S2PQ_STATUS_INTERNAL);
#endif

  CHECK(s2pq_sketch_from_json((const uint8_t *)json, length, &sketch) == S2PQ_STATUS_OK);
  CHECK(sketch_to_surface(session, sketch, NULL, &surface) == S2PQ_STATUS_OK);
  CHECK(sketch_to_cdf(session, sketch, surface, NULL, &field) == S2PQ_STATUS_OK);
  CHECK(extract_pq_mesh(session, field, NULL, &mesh) == S2PQ_STATUS_OK);
  CHECK(s2pq_mesh_faces(mesh, &starts, &indices, &faces) == S2PQ_STATUS_OK && faces > 100);
  for (i = 0; i < faces; i++) CHECK(starts[i + 1] >= starts[i] + 3 && indices[starts[i]] != indices[starts[i] + 1]);
  CHECK(s2pq_mesh_obj(mesh, &text, &length) == S2PQ_STATUS_OK && strlen(text) == length);
  CHECK(s2pq_mesh_report_json(mesh, &text, NULL) == S2PQ_STATUS_OK && strstr(text, "\"p_max\"") != NULL);
  s2pq_mesh_free(mesh);

  bad_pointers(session);
  struct_sizes(session, field);
  progress_and_cancel(session, sketch);
  preview(surface);
  live(json, strlen(json));
  broken_sketches(session);
  own_surface(session);
  own_panels(session);

  s2pq_field_free(field);
  s2pq_surface_free(surface);
  s2pq_sketch_free(sketch);
  s2pq_session_free(session);
  free(json);
  fprintf(stderr, failures ? "%d checks failed\n" : "host.c: all checks passed\n", failures);
  return failures != 0;
}
