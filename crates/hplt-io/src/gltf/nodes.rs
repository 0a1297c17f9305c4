use glam::{DAffine3, DMat3, DQuat, DVec3};

use super::buffers::item;
use super::json::{Document, Node};
use crate::{Error, Limits, LoadReport};

/// A node of the scene and where it is.
#[derive(Debug, Clone, Copy)]
pub(super) struct Placed {
    pub(super) node: u32,
    /// Composed in `f64` from the root down.
    pub(super) world_from_node: DAffine3,
}

/// The nodes of the default scene that hold something, parents before children, in the order of the file.
pub(super) fn placed(document: &Document, limits: &Limits, report: &mut LoadReport) -> Result<Vec<Placed>, Error> {
    let parents = parents(document)?;
    refuse_loops(&parents)?;
    let mut placed = Vec::new();
    // Depth, node and the transform of its parent; the last one is next.
    let mut stack: Vec<(u64, u32, DAffine3)> = Vec::new();
    for root in roots(document, &parents, report)? {
        stack.push((1, root, DAffine3::IDENTITY));
        while let Some((depth, node, world_from_parent)) = stack.pop() {
            if depth > limits.depth {
                return Err(Error::limit(place(document, node), "LIMIT_DEPTH", "generations", depth, limits.depth));
            }
            let entry = item(&document.nodes, node, "nodes")?;
            let world_from_node = world_from_parent * local(entry).map_err(|e| e.within(&place(document, node)))?;
            report.nodes += 1;
            if entry.mesh.is_some() || entry.camera.is_some() || entry.skin.is_some() || entry.extensions.is_some() {
                placed.push(Placed { node, world_from_node });
            }
            stack.extend(entry.children.iter().rev().map(|&child| (depth + 1, child, world_from_node)));
        }
    }
    Ok(placed)
}

/// How a node is called in messages.
pub(super) fn place(document: &Document, node: u32) -> String {
    match document.nodes.get(node as usize).and_then(|n| n.name.as_deref()) {
        Some(name) => format!("nodes[{node}] \"{}\"", crate::sanitized(name)),
        None => format!("nodes[{node}]"),
    }
}

/// The parent of every node; each has one at most.
fn parents(document: &Document) -> Result<Vec<Option<u32>>, Error> {
    let mut parents = vec![None; document.nodes.len()];
    for (parent, node) in document.nodes.iter().enumerate() {
        for (i, &child) in node.children.iter().enumerate() {
            let place = || format!("nodes[{parent}].children[{i}]");
            item(&document.nodes, child, "nodes").map_err(|e| e.within(&place()))?;
            if let Some(other) = parents[child as usize].replace(parent as u32) {
                let message = format!("nodes[{child}] has a parent already, nodes[{other}]");
                return Err(Error::invalid(place(), "NODE_PARENT_OVERRIDE", message));
            }
        }
    }
    Ok(parents)
}

/// Follows every chain of parents once.
fn refuse_loops(parents: &[Option<u32>]) -> Result<(), Error> {
    // The walk in which a node was seen, from 1.
    let mut seen = vec![0u32; parents.len()];
    for start in 0..parents.len() as u32 {
        let mut at = Some(start);
        while let Some(node) = at {
            match seen[node as usize] {
                0 => seen[node as usize] = start + 1,
                walk if walk == start + 1 => {
                    let message = "is its own ancestor";
                    return Err(Error::invalid(format!("nodes[{node}]"), "NODE_LOOP", message));
                }
                _ => break,
            }
            at = parents[node as usize];
        }
    }
    Ok(())
}

fn roots(document: &Document, parents: &[Option<u32>], report: &mut LoadReport) -> Result<Vec<u32>, Error> {
    if document.scenes.is_empty() && document.scene.is_none() {
        report.warn("the file has no scene; all its nodes are taken");
        return Ok((0..parents.len() as u32).filter(|&n| parents[n as usize].is_none()).collect());
    }
    let index = document.scene.unwrap_or(0);
    let scene = item(&document.scenes, index, "scenes")?;
    if document.scenes.len() > 1 {
        report.leave_out(format!("{} other scenes of the file; scene {index} is taken", document.scenes.len() - 1));
    }
    let mut is_root = vec![false; parents.len()];
    for (i, &node) in scene.nodes.iter().enumerate() {
        let place = || format!("scenes[{index}].nodes[{i}]");
        item(&document.nodes, node, "nodes").map_err(|e| e.within(&place()))?;
        if parents[node as usize].is_some() {
            let message = format!("nodes[{node}] has a parent; expected a root");
            return Err(Error::invalid(place(), "SCENE_NON_ROOT_NODE", message));
        }
        if std::mem::replace(&mut is_root[node as usize], true) {
            return Err(Error::invalid(place(), "DUPLICATE_ELEMENTS", format!("nodes[{node}] is listed twice")));
        }
    }
    Ok(scene.nodes.to_vec())
}

fn local(node: &Node) -> Result<DAffine3, Error> {
    let has_trs = node.translation.is_some() || node.rotation.is_some() || node.scale.is_some();
    if let Some(m) = &node.matrix {
        if has_trs {
            return Err(Error::invalid("matrix", "NODE_MATRIX_TRS", "stands beside translation, rotation or scale"));
        }
        if [m[3], m[7], m[11], m[15]] != [0.0, 0.0, 0.0, 1.0] {
            return Err(Error::invalid("matrix", "NODE_MATRIX_NON_TRS", "has a last row other than 0 0 0 1"));
        }
        let column = |k: usize| DVec3::new(m[k], m[k + 1], m[k + 2]);
        return Ok(DAffine3::from_mat3_translation(DMat3::from_cols(column(0), column(4), column(8)), column(12)));
    }
    let rotation = match &node.rotation {
        Some(rotation) => unit_quaternion(**rotation)?,
        None => DQuat::IDENTITY,
    };
    Ok(DAffine3::from_scale_rotation_translation(
        node.scale.as_deref().map_or(DVec3::ONE, |s| DVec3::from(*s)),
        rotation,
        node.translation.as_deref().map_or(DVec3::ZERO, |t| DVec3::from(*t)),
    ))
}

/// The quaternion, brought to unit length.
pub(super) fn unit_quaternion(xyzw: [f64; 4]) -> Result<DQuat, Error> {
    let quaternion = DQuat::from_array(xyzw);
    let length = quaternion.length();
    if length.is_finite() && length > 1e-6 {
        return Ok(quaternion / length);
    }
    Err(Error::invalid("rotation", "ROTATION_NON_UNIT", format!("length {length}; expected 1")))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn walk(json: &str) -> Result<Vec<Placed>, Error> {
        let limits = Limits::default();
        placed(&Document::parse(json.as_bytes(), &limits).unwrap(), &limits, &mut LoadReport::default())
    }

    fn code(json: &str) -> &'static str {
        walk(json).unwrap_err().code()
    }

    #[test]
    fn transforms_are_composed_in_double_precision() {
        let json = r#"{"scenes":[{"nodes":[0]}],"nodes":[
            {"translation":[1000000,0,0],"children":[1]},
            {"mesh":0,"rotation":[0,0,0.7071067811865476,0.7071067811865476],"scale":[2,2,2],"translation":[0.0001,0,0]}]}"#;
        let point = walk(json).unwrap()[0].world_from_node.transform_point3(DVec3::new(1e-5, 0.0, 0.0));
        assert!((point - DVec3::new(1_000_000.000_1, 2e-5, 0.0)).length() < 1e-9, "{point}");
    }

    #[test]
    fn rotations_of_any_length_are_brought_to_length_one() {
        let json = r#"{"nodes":[{"mesh":0,"rotation":[0,0,3,3]}]}"#;
        let x = walk(json).unwrap()[0].world_from_node.transform_vector3(DVec3::X);
        assert!((x - DVec3::Y).length() < 1e-15);
        assert_eq!(code(r#"{"nodes":[{"rotation":[0,0,0,0]}]}"#), "ROTATION_NON_UNIT");
        assert_eq!(code(r#"{"nodes":[{"rotation":[1e300,1e300,0,0]}]}"#), "ROTATION_NON_UNIT");
    }

    #[test]
    fn everything_but_a_forest_is_refused() {
        assert_eq!(code(r#"{"nodes":[{"children":[1]},{"children":[0]}]}"#), "NODE_LOOP");
        assert_eq!(code(r#"{"nodes":[{"children":[0]}]}"#), "NODE_LOOP");
        assert_eq!(code(r#"{"nodes":[{"children":[1,1]},{}]}"#), "NODE_PARENT_OVERRIDE");
        assert_eq!(code(r#"{"nodes":[{"children":[2]},{"children":[2]},{}]}"#), "NODE_PARENT_OVERRIDE");
        assert_eq!(code(r#"{"nodes":[{"children":[7]}]}"#), "UNRESOLVED_REFERENCE");
        assert_eq!(code(r#"{"scenes":[{"nodes":[1]}],"nodes":[{"children":[1]},{}]}"#), "SCENE_NON_ROOT_NODE");
        assert_eq!(code(r#"{"scenes":[{"nodes":[0,0]}],"nodes":[{}]}"#), "DUPLICATE_ELEMENTS");
        assert_eq!(code(r#"{"scene":1,"scenes":[{"nodes":[0]}],"nodes":[{}]}"#), "UNRESOLVED_REFERENCE");
        assert_eq!(
            code(r#"{"nodes":[{"matrix":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1],"scale":[1,1,1]}]}"#),
            "NODE_MATRIX_TRS"
        );
        assert_eq!(code(r#"{"nodes":[{"matrix":[1,0,0,1,0,1,0,0,0,0,1,0,0,0,0,1]}]}"#), "NODE_MATRIX_NON_TRS");
        let chain: Vec<String> = (1..1025).map(|i| format!("{{\"children\":[{i}]}}")).collect();
        assert_eq!(code(&format!("{{\"nodes\":[{},{{}}]}}", chain.join(","))), "LIMIT_DEPTH");
    }

    #[test]
    fn a_node_in_two_scenes_is_walked_once() {
        let json =
            r#"{"scenes":[{"nodes":[0]},{"nodes":[0]}],"nodes":[{"mesh":0,"children":[2,1]},{"mesh":0},{"mesh":0}]}"#;
        let order: Vec<u32> = walk(json).unwrap().iter().map(|p| p.node).collect();
        assert_eq!(order, [0, 2, 1]);
    }
}
