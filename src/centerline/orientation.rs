//! A line told from its root: nodes and branches in the order in which a walk from there meets them.

use nalgebra::Point3;

use crate::centerline::component::ComponentGraph;
use crate::centerline::graph::NodeKind;

/// Makes the end nearest to `place` (on a line without ends, the node) the first, and numbers nodes and branches by a
/// breadth first walk from it; each branch starts at the node that the walk meets first. O(nodes x branches).
pub fn tell_from(graph: &mut ComponentGraph, place: &Point3<f64>) {
    let away = |node: usize| (graph.nodes[node].position - place).norm();
    let all = || 0..graph.nodes.len();
    let nearest = |wanted: &dyn Fn(usize) -> bool| {
        all().filter(|&node| wanted(node)).min_by(|&a, &b| away(a).total_cmp(&away(b)))
    };
    let is_end = |node: usize| graph.nodes[node].kind == NodeKind::End;
    let Some(root) = nearest(&is_end).or_else(|| nearest(&|_| true)) else { return };
    let mut order = vec![root];
    let mut ways: Vec<(usize, bool)> = Vec::new();
    let mut told = vec![false; graph.branches.len()];
    let mut cursor = 0;
    while let Some(&node) = order.get(cursor) {
        cursor += 1;
        for (index, branch) in graph.branches.iter().enumerate() {
            if told[index] || (branch.from != node && branch.to != node) {
                continue;
            }
            told[index] = true;
            let forward = branch.from == node;
            ways.push((index, forward));
            let next = if forward { branch.to } else { branch.from };
            if !order.contains(&next) {
                order.push(next);
            }
        }
    }
    // A part that the walk does not reach keeps its order behind it.
    let rest: Vec<usize> = all().filter(|node| !order.contains(node)).collect();
    order.extend(rest);
    ways.extend((0..told.len()).filter(|&index| !told[index]).map(|index| (index, true)));
    let mut number = vec![0; order.len()];
    order.iter().enumerate().for_each(|(new, &old)| number[old] = new);
    graph.nodes = order.iter().map(|&node| graph.nodes[node].clone()).collect();
    let turned = |&(index, forward): &(usize, bool)| {
        let mut branch = graph.branches[index].clone();
        (branch.from, branch.to) = (number[branch.from], number[branch.to]);
        if !forward {
            std::mem::swap(&mut branch.from, &mut branch.to);
            branch.points.reverse();
            branch.radii.reverse();
            branch.equivalent_radii.reverse();
        }
        branch
    };
    graph.branches = ways.iter().map(turned).collect();
}
