//! The meshes of a glTF scene, each with the transform of its node.

use gltf::json::{Mesh, Node, Root};
use nalgebra::{Matrix4, Quaternion, UnitQuaternion, Vector3};

use super::gltf::malformed;
use super::{Format, ReadError};

/// The meshes of the default scene, or of the first, or, in a file without scenes, of all root nodes.
///
/// # Errors
/// `Malformed` for a reference to nothing and for a node with two parents (or itself among its
/// descendants), which glTF forbids.
pub(super) fn placed_meshes(format: Format, root: &Root) -> Result<Vec<(&Mesh, Matrix4<f64>)>, ReadError> {
    let dangling = |what: &str| malformed(format, format!("it refers to a {what} that is not there"));
    let mut placed = Vec::new();
    if root.nodes.is_empty() {
        placed.extend(root.meshes.iter().map(|mesh| (mesh, Matrix4::identity())));
        return Ok(placed);
    }
    let scene = root.scene.map_or(0, |scene| scene.value());
    let roots: Vec<usize> = match root.scenes.get(scene) {
        Some(scene) => scene.nodes.iter().map(|node| node.value()).collect(),
        None if root.scenes.is_empty() => roots(root),
        None => return Err(dangling("scene")),
    };
    // First in the file, first out of the stack.
    let mut stack: Vec<_> = roots.into_iter().rev().map(|node| (node, Matrix4::identity())).collect();
    let mut seen = vec![false; root.nodes.len()];
    while let Some((index, parent)) = stack.pop() {
        let node = root.nodes.get(index).ok_or_else(|| dangling("node"))?;
        if std::mem::replace(&mut seen[index], true) {
            return Err(malformed(format, format!("node {index} has two parents")));
        }
        let transform = parent * local_transform(node);
        if let Some(mesh) = node.mesh {
            let mesh = root.meshes.get(mesh.value()).ok_or_else(|| dangling("mesh"))?;
            placed.push((mesh, transform));
        }
        let children = node.children.iter().flatten().rev();
        stack.extend(children.map(|child| (child.value(), transform)));
    }
    Ok(placed)
}

/// The nodes that are nobody's children.
fn roots(root: &Root) -> Vec<usize> {
    let mut is_child = vec![false; root.nodes.len()];
    for child in root.nodes.iter().flat_map(|node| node.children.iter().flatten()) {
        if let Some(flag) = is_child.get_mut(child.value()) {
            *flag = true;
        }
    }
    (0..root.nodes.len()).filter(|&node| !is_child[node]).collect()
}

/// A node's matrix, or its translation, rotation and scale in this order (section 5.25).
fn local_transform(node: &Node) -> Matrix4<f64> {
    if let Some(matrix) = node.matrix {
        return Matrix4::from_column_slice(&matrix.map(f64::from));
    }
    let translation = Vector3::from(node.translation.unwrap_or([0.0; 3]).map(f64::from));
    let scale = Vector3::from(node.scale.unwrap_or([1.0; 3]).map(f64::from));
    let [x, y, z, w] = node.rotation.map_or([0.0, 0.0, 0.0, 1.0], |rotation| rotation.0.map(f64::from));
    let rotation = UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z));
    Matrix4::new_translation(&translation)
        * rotation.to_homogeneous()
        * Matrix4::new_nonuniform_scaling(&scale)
}
