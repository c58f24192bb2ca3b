/* A sketch in, counts out: the three calls.
 *
 *   cargo build --release
 *   ln -sf libsketch2pq.so target/release/libsketch2pq.so.0
 *   cc -std=c99 -Iinclude examples/sketch_to_panels.c -Ltarget/release -lsketch2pq \
 *      -Wl,-rpath,'$ORIGIN' -o target/release/sketch_to_panels
 *   target/release/sketch_to_panels
 */
#include "sketch2pq.h"
#include <stdio.h>

/* Says what went wrong; 1 if something did. */
static int failed(S2pqStatus status) {
  char message[512];
  if (status == S2PQ_STATUS_OK) return 0;
  s2pq_last_message(message, sizeof message);
  fprintf(stderr, "%s: %s\n", s2pq_status_name(status), message);
  return 1;
}

/* A leaning sheet, drawn on a canvas of 256 pixels: four border strokes and one feature line. */
static S2pqSketch *draw(void) {
  static const double bottom[] = {30, 190, 80, 215, 130, 222, 180, 214, 228, 192};
  static const double right[] = {228, 192, 222, 150, 214, 108, 204, 70};
  static const double top[] = {204, 70, 165, 48, 125, 42, 88, 50, 52, 72};
  static const double left[] = {52, 72, 44, 110, 37, 150, 30, 190};
  static const double feature[] = {130, 215, 129, 160, 127, 105, 126, 52};
  S2pqSketch *sketch = NULL;
  s2pq_sketch_new(&sketch);
  s2pq_sketch_add_stroke(sketch, S2PQ_STROKE_KIND_VISIBLE_BOUNDARY, bottom, 5);
  s2pq_sketch_add_stroke(sketch, S2PQ_STROKE_KIND_VISIBLE_BOUNDARY, right, 4);
  s2pq_sketch_add_stroke(sketch, S2PQ_STROKE_KIND_VISIBLE_BOUNDARY, top, 5);
  s2pq_sketch_add_stroke(sketch, S2PQ_STROKE_KIND_VISIBLE_BOUNDARY, left, 4);
  s2pq_sketch_add_stroke(sketch, S2PQ_STROKE_KIND_FEATURE, feature, 4);
  return sketch;
}

int main(void) {
  S2pqSession *session = NULL;
  S2pqSketch *sketch = draw();
  S2pqSurface *surface = NULL;
  S2pqField *field = NULL;
  S2pqMesh *mesh = NULL;
  S2pqMeshReport report = {.struct_size = sizeof report};
  int bad = failed(s2pq_session_new(NULL, &session)) ||
            failed(sketch_to_surface(session, sketch, NULL, &surface)) ||
            failed(sketch_to_cdf(session, sketch, surface, NULL, &field)) ||
            failed(extract_pq_mesh(session, field, NULL, &mesh)) ||
            failed(s2pq_mesh_report(mesh, &report));
  if (!bad) {
    printf("%u faces, %u of them quads, planar to %.1e\n", report.faces, report.quads, report.planarity_max);
  }
  s2pq_mesh_free(mesh);
  s2pq_field_free(field);
  s2pq_surface_free(surface);
  s2pq_sketch_free(sketch);
  s2pq_session_free(session);
  return bad;
}
