//! Panel meshes as Wavefront OBJ text.

use super::panel_mesh::PanelMesh;
use crate::error::Error;
use nalgebra::Point3;
use std::fmt::Write;

/// Most vertices and most face corners that [`read_obj`] accepts.
const LIMIT: usize = 50_000_000;

/// Writes patches as OBJ text, each an object `o patch_0`, `o patch_1`, ...; quads and larger polygons as they are.
///
/// Coordinates are written with as many digits as it takes to read the very same numbers back; indices count on over the patches.
pub fn write_obj(patches: &[&PanelMesh]) -> String {
    let mut text = String::from("# panel mesh, z up\n");
    let mut first = 1;
    for (index, mesh) in patches.iter().enumerate() {
        let _ = writeln!(text, "o patch_{index}");
        for p in &mesh.vertices {
            let _ = writeln!(text, "v {} {} {}", p.x, p.y, p.z);
        }
        for face in mesh.faces() {
            text.push('f');
            for &v in face {
                let _ = write!(text, " {}", v as usize + first);
            }
            text.push('\n');
        }
        first += mesh.vertices.len();
    }
    text
}

/// Reads OBJ text into one mesh for each object (`o`) or group (`g`) that has faces.
///
/// Texture and normal indices are skipped, negative indices count back from the latest vertex, and each mesh keeps only
/// the vertices that its faces use, in their order in the file; a text without faces gives no mesh.
///
/// # Errors
/// [`Error::Format`] with the line for a number that cannot be read or an index of no vertex, and for a face that is no
/// polygon; [`Error::NotFinite`] for a coordinate that is not finite; [`Error::TooLarge`].
pub fn read_obj(text: &str) -> Result<Vec<PanelMesh>, Error> {
    let mut vertices: Vec<Point3<f64>> = vec![];
    let mut groups: Vec<Vec<Vec<u32>>> = vec![vec![]];
    let mut corners = 0;
    for (number, line) in text.lines().enumerate() {
        let fail = |reason: String| Error::Format { what: "OBJ", reason: format!("line {}: {reason}", number + 1) };
        let mut words = line.split('#').next().unwrap_or("").split_ascii_whitespace();
        match words.next() {
            Some("v") => {
                let mut point = Point3::<f64>::origin();
                for k in 0..3 {
                    let word = words.next().ok_or_else(|| fail("a vertex needs three coordinates".into()))?;
                    point[k] = word.parse().map_err(|_| fail(format!("'{word}' is not a number")))?;
                }
                if !point.iter().all(|x| x.is_finite()) {
                    return Err(Error::NotFinite { what: "vertex", index: vertices.len() });
                }
                vertices.push(point);
            }
            Some("f") => {
                let mut face: Vec<u32> = vec![];
                for word in words {
                    let index: i64 = word
                        .split('/')
                        .next()
                        .unwrap_or("")
                        .parse()
                        .map_err(|_| fail(format!("'{word}' is not an index")))?;
                    let count = vertices.len() as i64;
                    let place = if index < 0 { count.saturating_add(index) } else { index.saturating_sub(1) };
                    if !(0..count).contains(&place) {
                        return Err(fail(format!("index {index} of {count} vertices")));
                    }
                    face.push(place as u32);
                }
                let repeated = (1..face.len()).any(|i| face[..i].contains(&face[i]));
                if face.len() < 3 || repeated {
                    return Err(fail("a face needs three or more corners, all different".into()));
                }
                corners += face.len();
                if let Some(group) = groups.last_mut() {
                    group.push(face);
                }
            }
            Some("o" | "g") => groups.push(vec![]),
            _ => {}
        }
        let count = vertices.len().max(corners);
        if count > LIMIT {
            return Err(Error::TooLarge { what: "vertices or face corners", count, limit: LIMIT });
        }
    }
    let mut meshes = vec![];
    let mut place = vec![u32::MAX; vertices.len()];
    for mut faces in groups.into_iter().filter(|g| !g.is_empty()) {
        let mut used: Vec<u32> = faces.iter().flatten().copied().collect();
        used.sort_unstable();
        used.dedup();
        used.iter().enumerate().for_each(|(new, &old)| place[old as usize] = new as u32);
        faces.iter_mut().flatten().for_each(|v| *v = place[*v as usize]);
        meshes.push(PanelMesh::new(used.iter().map(|&v| vertices[v as usize]).collect(), &faces)?);
    }
    Ok(meshes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn house() -> PanelMesh {
        let vertices = [[0.1, 0.0, 1e-7], [1.0 / 3.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.5, 1e20, 0.0], [0.0, 1.0, -0.0]];
        let faces: [&[u32]; 2] = [&[0, 1, 2, 3, 4], &[0, 1, 2]];
        PanelMesh::new(vertices.map(Point3::from).to_vec(), &faces).unwrap()
    }

    #[test]
    fn what_is_written_is_read_back_exactly() {
        let house = house();
        let text = write_obj(&[&house, &house]);
        assert!(text.contains("o patch_1") && text.contains("f 6 7 8 9 10"));
        assert_eq!(read_obj(&text).unwrap(), [house.clone(), house]);
    }

    #[test]
    fn other_programs_files_are_read() {
        let text = "mtllib x.mtl\nv 0 0 0 1.0\r\nv 1 0 0\nv 1 1 0 # corner\nvn 0 0 1\ns off\nf -3/1/1 -2//1 3/2\n";
        let meshes = read_obj(text).unwrap();
        assert_eq!(meshes.len(), 1);
        assert_eq!(meshes[0].face(0), [0, 1, 2]);
        assert!(read_obj("").unwrap().is_empty());
    }

    #[test]
    fn broken_files_are_refused() {
        for text in ["v 0 0", "v 0 0 x", "v 0 0 0\nf 1 2 3", "v 0 0 0\nf 1 1 1", "v 0 0 0\nf 0 1 1", "v 0 0 nan", "f a"]
        {
            assert!(read_obj(text).is_err(), "{text}");
        }
        let whole = write_obj(&[&house()]);
        for end in 0..whole.len() {
            let _ = read_obj(&whole[..end]);
        }
    }
}
