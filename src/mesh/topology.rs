//! Is it a manifold? Edges, border loops, components of a panel mesh.

use super::panel_mesh::PanelMesh;

/// What [`check`] finds.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Topology {
    /// Undirected edges.
    pub edges: usize,
    /// Edges with more than two faces.
    pub non_manifold_edges: usize,
    /// Edges whose two faces run through them in the same direction.
    pub misoriented_edges: usize,
    /// Vertices whose faces form more than one fan.
    pub pinched_vertices: usize,
    /// Vertices without faces.
    pub unused_vertices: usize,
    /// Sets of faces connected over edges.
    pub components: usize,
    /// Closed loops of border edges.
    pub border_loops: usize,
    /// Used vertices - edges + faces; 1 for a disk.
    pub euler_characteristic: i64,
    /// Inner vertices that have other than four edges.
    pub irregular_vertices: usize,
    /// Whether each vertex lies on the border.
    pub on_border: Vec<bool>,
}

impl Topology {
    /// Whether the mesh is an oriented manifold, with or without border.
    pub fn is_manifold(&self) -> bool {
        self.non_manifold_edges == 0 && self.misoriented_edges == 0 && self.pinched_vertices == 0
    }

    /// Whether the mesh is one disk.
    pub fn is_disk(&self) -> bool {
        self.is_manifold() && self.components == 1 && self.border_loops == 1 && self.euler_characteristic == 1
    }
}

/// Sides of all faces as (smaller vertex, larger vertex, runs from larger to smaller, face), sorted.
fn sides(mesh: &PanelMesh) -> Vec<(u32, u32, bool, u32)> {
    let mut sides = Vec::with_capacity(mesh.indices.len());
    for (f, face) in mesh.faces().enumerate() {
        for (k, &a) in face.iter().enumerate() {
            let b = face[(k + 1) % face.len()];
            sides.push((a.min(b), a.max(b), a > b, f as u32));
        }
    }
    sides.sort_unstable();
    sides
}

/// Counts what makes a mesh a manifold, and what does not.
pub fn check(mesh: &PanelMesh) -> Topology {
    let count = mesh.vertices.len();
    let mut topology = Topology { on_border: vec![false; count], ..Topology::default() };
    let sides = sides(mesh);
    let mut degree = vec![0usize; count];
    let mut face_set = Sets::new(mesh.face_count());
    // Border edges, directed as their face runs.
    let mut border: Vec<(u32, u32)> = vec![];
    let mut i = 0;
    while i < sides.len() {
        let (a, b, ..) = sides[i];
        let group = sides[i..].iter().take_while(|s| (s.0, s.1) == (a, b)).count();
        topology.edges += 1;
        degree[a as usize] += 1;
        degree[b as usize] += 1;
        for k in 1..group {
            face_set.union(sides[i].3, sides[i + k].3);
        }
        match group {
            1 => {
                topology.on_border[a as usize] = true;
                topology.on_border[b as usize] = true;
                border.push(if sides[i].2 { (b, a) } else { (a, b) });
            }
            2 => topology.misoriented_edges += usize::from(sides[i].2 == sides[i + 1].2),
            _ => topology.non_manifold_edges += 1,
        }
        i += group;
    }
    topology.components = face_set.count();
    // Corners around each vertex, united over shared edges: one set for each fan.
    let mut corner_of_side = std::collections::BTreeMap::new();
    let mut corner = 0u32;
    for face in mesh.faces() {
        for (k, &a) in face.iter().enumerate() {
            let next = face[(k + 1) % face.len()];
            corner_of_side.entry((a, next)).or_insert(corner + k as u32);
        }
        corner += face.len() as u32;
    }
    let mut fans = Sets::new(corner as usize);
    corner = 0;
    for face in mesh.faces() {
        for (k, &a) in face.iter().enumerate() {
            // The corner at `a` of the face beyond the side that arrives here.
            let before = face[(k + face.len() - 1) % face.len()];
            if let Some(&other) = corner_of_side.get(&(a, before)) {
                fans.union(corner + k as u32, other);
            }
        }
        corner += face.len() as u32;
    }
    let mut fan_count = vec![0usize; count];
    for (c, &v) in mesh.indices.iter().enumerate() {
        fan_count[v as usize] += usize::from(fans.find(c as u32) == c as u32);
    }
    topology.pinched_vertices = fan_count.iter().filter(|&&f| f > 1).count();
    topology.unused_vertices = fan_count.iter().filter(|&&f| f == 0).count();
    topology.irregular_vertices =
        (0..count).filter(|&v| fan_count[v] > 0 && !topology.on_border[v] && degree[v] != 4).count();
    let mut loops = Sets::new(count);
    for &(a, b) in &border {
        loops.union(a, b);
    }
    topology.border_loops = (0..count as u32).filter(|&v| topology.on_border[v as usize] && loops.find(v) == v).count();
    topology.euler_characteristic =
        (count - topology.unused_vertices) as i64 - topology.edges as i64 + mesh.face_count() as i64;
    topology
}

/// Disjoint sets, each named by its smallest member.
struct Sets {
    parent: Vec<u32>,
}

impl Sets {
    fn new(count: usize) -> Self {
        Self { parent: (0..count as u32).collect() }
    }

    fn find(&mut self, mut x: u32) -> u32 {
        while self.parent[x as usize] != x {
            self.parent[x as usize] = self.parent[self.parent[x as usize] as usize];
            x = self.parent[x as usize];
        }
        x
    }

    fn union(&mut self, a: u32, b: u32) {
        let (a, b) = (self.find(a), self.find(b));
        self.parent[a.max(b) as usize] = a.min(b);
    }

    fn count(&mut self) -> usize {
        (0..self.parent.len() as u32).filter(|&x| self.find(x) == x).count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    fn mesh(count: usize, faces: &[&[u32]]) -> PanelMesh {
        let points = (0..count).map(|i| Point3::new(i as f64, (i * i) as f64, 0.0)).collect();
        PanelMesh::new(points, faces).unwrap()
    }

    #[test]
    fn a_strip_of_two_quads_is_a_disk() {
        let topology = check(&mesh(6, &[&[0, 1, 4, 3], &[1, 2, 5, 4]]));
        assert!(topology.is_disk());
        assert_eq!((topology.edges, topology.irregular_vertices), (7, 0));
    }

    #[test]
    fn defects_are_counted() {
        assert_eq!(check(&mesh(5, &[&[0, 1, 2], &[1, 0, 3], &[0, 1, 4]])).non_manifold_edges, 1);
        assert_eq!(check(&mesh(4, &[&[0, 1, 2], &[0, 1, 3]])).misoriented_edges, 1);
        let pinched = check(&mesh(5, &[&[0, 1, 2], &[0, 3, 4]]));
        assert_eq!((pinched.pinched_vertices, pinched.components), (1, 2));
        assert_eq!(check(&mesh(7, &[&[0, 1, 2], &[3, 4, 5]])).unused_vertices, 1);
    }

    #[test]
    fn a_tetrahedron_is_a_sphere() {
        let topology = check(&mesh(4, &[&[0, 2, 1], &[0, 1, 3], &[1, 2, 3], &[2, 0, 3]]));
        assert!(topology.is_manifold());
        assert_eq!((topology.euler_characteristic, topology.border_loops, topology.irregular_vertices), (2, 0, 4));
    }
}
