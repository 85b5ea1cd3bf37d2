//! The preset `default`: the paper's stages, scaled to the local radius and with homotopy by construction.
//!
//! Tips and segmentation come from the Reeb graph of a geodesic distance, centerline points from
//! closed sections, joints from the branches' own continuation. `docs/method.md` has the reasons.

use rayon::prelude::*;

use crate::mesh::preparation::{Opening, Surface};

use crate::centerline::component::ComponentGraph;
use crate::centerline::connection::network::Network;
use crate::centerline::connection::unsupported;
use crate::centerline::cut_plane::bulges::{at_wall, round_bulge};
use crate::centerline::cut_plane::cross_sections::{judge_outward, settle};
use crate::centerline::cut_plane::march::{Toward, close_ring, fill_gaps, march};
use crate::centerline::cut_plane::ownership::{Wall, owners};
use crate::centerline::cut_plane::stubs::{RINGS, stations_before};
use crate::centerline::laplacian_smoothing::branch::{choose_stiffness, observe, smooth};
use crate::centerline::recentering::displaced::settle_displaced;
use crate::centerline::recentering::ends::reach_ends;
use crate::centerline::recentering::hidden_radii::widen_before_throats;
use crate::centerline::recentering::joint_fit::{FittedJoint, FittedLimb, carry_hidden, fit_joint};
use crate::centerline::recentering::meeting::{aim_bulges, meet_in_joints};
use crate::centerline::recentering::sweep::recenter_branches;
use crate::centerline::segmentation::level_sets::LevelSet;
use crate::centerline::segmentation::track::{SPACING, Sight, Station, Track, rings, stations_of};
use crate::centerline::tips::picks::Picks;
use crate::centerline::tips::reeb::ReebGraph;
use crate::centerline::tips::root::Among;
use crate::centerline::tips::skeleton::skeleton;
use crate::centerline::tips::{Branching, Chain};
use crate::centerline::triangle_grid::TriangleGrid;
use crate::centerline::{Control, ExtractError, Parameters, Stage};

/// The centerline of one component, and its triangles, sorted on the way.
///
/// # Errors
/// [`ExtractError::NotTubular`] for a blob, [`ExtractError::Cancelled`].
pub fn extract_component<'a>(
    surface: &'a Surface,
    parameters: &Parameters,
    picks: &Picks,
    control: &Control<'_>,
) -> Result<(TriangleGrid<'a>, ComponentGraph), ExtractError> {
    control.report(Stage::Tips, 0.0)?;
    // The first front has nothing beside it.
    let (grid, found) = rayon::join(
        || TriangleGrid::new(surface),
        || skeleton(surface, parameters.tip_height(), picks, Among::AllEnds, control),
    );
    let (graph, branching) = found?;
    let result = connect(&grid, &graph, &branching, control)?;
    Ok((grid, result))
}

/// The line along the branches of the Reeb graph: all stages after the segmentation.
fn connect(
    grid: &TriangleGrid<'_>,
    graph: &ReebGraph,
    branching: &Branching,
    control: &Control<'_>,
) -> Result<ComponentGraph, ExtractError> {
    let surface = grid.surface();
    let Branching { chains, raised, .. } = branching;
    let mut network = Network::new(graph, chains);
    control.report(Stage::CutPlanes, 0.0)?;
    let look = || {
        let work = network.tracks.par_iter_mut().zip(chains);
        let one = |(track, chain): (&mut Track, &Chain)| {
            control.cancel.check()?;
            track.rings = rings(surface, graph, chain);
            Ok::<(), ExtractError>(())
        };
        work.try_for_each(one)
    };
    let (owners, looked) = rayon::join(|| owners(surface, graph, chains), look);
    looked?;
    let trusted = cut_planes(grid, graph, (chains, raised), &owners, &mut network, control)?;
    if network.tracks.iter().all(|track| track.stations.iter().all(|s| s.sight != Sight::Clean)) {
        let detail = "no plane cuts it in a closed section that is one vessel's own".to_owned();
        return Err(ExtractError::Undersampled { detail });
    }
    settle_displaced(surface, &owners, &mut network);
    network.contract_short(&trusted);
    control.report(Stage::LaplacianSmoothing, 0.0)?;
    network.tracks.par_iter_mut().for_each(|track| {
        track.stiffness = choose_stiffness(&track.stations);
        track.process = observe(&track.stations);
        smooth(track, None, None);
    });
    control.report(Stage::Recentering, 0.0)?;
    reach_ends(grid, &mut network, &Track::is_line, control)?;
    meet_in_joints(grid, &owners, &mut network, control)?;
    recenter_branches(grid, &mut network, control)?;
    fit_joints(grid, &mut network, control)?;
    widen_before_throats(grid, &mut network);
    control.report(Stage::Connection, 0.0)?;
    let mut result = network.connect();
    let bridged = unsupported::check(&network, grid, &result);
    result.warnings.extend(bridged);
    result.warnings.extend(branching.warning());
    let missed = branching.missed_warning(surface, graph, &result);
    result.warnings.extend(missed);
    refuse_blob(surface, &result)?;
    control.report(Stage::Connection, 1.0)?;
    Ok(result)
}

/// Stations at the level sets and judged sections of every branch; returns which branches have a section of their own.
fn cut_planes(
    grid: &TriangleGrid<'_>,
    graph: &ReebGraph,
    (chains, raised): (&[Chain], &[u32]),
    owners: &[u32],
    network: &mut Network,
    control: &Control<'_>,
) -> Result<Vec<bool>, ExtractError> {
    let surface = grid.surface();
    let level = |node: usize, reeb: u32| network.is_end(node).then(|| rim_level(surface, graph, reeb));
    let levels_of =
        |(track, chain): (&Track, &Chain)| [level(track.from, chain.from), level(track.to, chain.to)];
    let levels: Vec<[Option<f64>; 2]> = network.tracks.iter().zip(chains).map(levels_of).collect();
    let rings_alone: Vec<bool> = network.tracks.iter().map(|track| network.is_ring(track.from)).collect();
    let work = network.tracks.par_iter_mut().zip(chains).zip(&levels).zip(rings_alone).enumerate();
    work.map(|(number, (((track, chain), &[from_level, to_level]), ring))| {
        control.cancel.check()?;
        leave_caps_out(&mut track.rings, from_level, to_level);
        track.stations = stations_of(&track.rings);
        let at_end = from_level.is_none();
        let is_leaf = at_end != to_level.is_none();
        let tip = graph.nodes[if at_end { chain.to } else { chain.from } as usize].vertex;
        let opening = surface.opening_at(tip).filter(|_| is_leaf);
        // An opening is no dome: a stump that was cut runs straight to it.
        if is_leaf && opening.is_none() && is_bulge(grid, track, (tip, at_end), raised) {
            return Ok(true);
        }
        match opening.filter(|_| (1..RINGS).contains(&track.rings.len())) {
            Some(opening) => track.oriented(at_end, |track| stations_before(surface, track, opening)),
            None => trim_tips(track, from_level, to_level),
        }
        settle(surface, track);
        control.cancel.check()?;
        let wall = Wall::new(surface, owners, number);
        let trusted = judge_outward(wall, track);
        march_on(wall, track, [from_level, to_level].map(|level| level.is_some()), ring);
        Ok(trusted)
    })
    .collect()
}

/// Whether a leaf is no line of stations: a tip that was picked on a wall, or a round bulge; it gets its bulge then.
fn is_bulge(grid: &TriangleGrid<'_>, track: &mut Track, (tip, at_end): (u32, bool), raised: &[u32]) -> bool {
    if raised.contains(&tip) {
        at_wall(grid.surface(), track, tip);
        return true;
    }
    round_bulge(grid, track, tip, !at_end)
}

/// From section to section through the gaps between stations, then on to both ends; `caps` says which of them are tips.
fn march_on(wall: Wall<'_>, track: &mut Track, caps: [bool; 2], ring: bool) {
    fill_gaps(wall, track);
    if ring {
        close_ring(wall, track);
        return;
    }
    let [from, to] = caps.map(|is_cap| if is_cap { Toward::Cap } else { Toward::Joint });
    march(wall, track, to);
    track.reverse();
    march(wall, track, from);
    track.reverse();
}

/// The distance at a tip; at an opening that at its rim, below the raised centre.
fn rim_level(surface: &Surface, graph: &ReebGraph, node: u32) -> f64 {
    let node = &graph.nodes[node as usize];
    let opening = surface.opening_at(node.vertex);
    let at_rim = |opening: &Opening| {
        opening.rim.iter().map(|&v| graph.function[v as usize]).fold(f64::INFINITY, f64::min)
    };
    opening.map_or(node.level, at_rim)
}

/// Drops the level sets past the rims of openings: they shrink toward the raised centre and say nothing of the
/// vessel.
///
/// `from_level` and `to_level` are the function at the tips; `None` at joints.
fn leave_caps_out(rings: &mut Vec<LevelSet>, from_level: Option<f64>, to_level: Option<f64>) {
    /// Of a branch that was cut close to its joint so many stay, the farthest from the cap.
    const LEAST: usize = 3;
    let (Some(first), Some(last)) = (rings.first(), rings.last()) else { return };
    let rises = last.level >= first.level;
    let over = |level: f64, tip: Option<f64>| tip.is_none_or(|tip| level >= tip);
    let under = |level: f64, tip: Option<f64>| tip.is_none_or(|tip| level <= tip);
    let keep = |ring: &LevelSet| {
        let (low, high) = if rises { (from_level, to_level) } else { (to_level, from_level) };
        over(ring.level, low) && under(ring.level, high)
    };
    if rings.iter().filter(|ring| keep(ring)).count() >= LEAST {
        rings.retain(keep);
    } else if from_level.is_none() {
        rings.truncate(LEAST);
    } else if to_level.is_none() {
        rings.drain(..rings.len().saturating_sub(LEAST));
    }
}

/// Rings close to a tip lie aslant over the cap: stations there would mislead.
///
/// `from_level` and `to_level` are the function at the tips; `None` at joints.
fn trim_tips(track: &mut Track, from_level: Option<f64>, to_level: Option<f64>) {
    /// Reach of a cap's influence, in radii.
    const CAP: f64 = 2.5;
    let mut radii: Vec<f64> = track.rings.iter().map(|ring| ring.radius()).collect();
    radii.sort_by(f64::total_cmp);
    let Some(&radius) = radii.get(radii.len() / 2) else { return };
    let levels = || track.rings.iter().map(|ring| ring.level);
    let span = levels().fold(f64::MIN, f64::max) - levels().fold(f64::MAX, f64::min);
    let reach = (CAP * radius).min(0.3 * span);
    let far =
        |ring: usize, tip: Option<f64>| tip.is_none_or(|tip| (track.rings[ring].level - tip).abs() > reach);
    let keep = |ring: usize| far(ring, from_level) && far(ring, to_level);
    if (0..track.rings.len()).filter(|&ring| keep(ring)).count() >= 3 {
        track.stations.retain(|station| keep(station.ring));
    }
}

/// Fits the joints to all the wall around them; those that come to lie together are one, and fitted anew.
fn fit_joints(
    grid: &TriangleGrid<'_>,
    network: &mut Network,
    control: &Control<'_>,
) -> Result<(), ExtractError> {
    let mut nodes: Vec<usize> = (0..network.nodes.len()).collect();
    while !nodes.is_empty() {
        let seen = &*network;
        let fit = |node: &usize| {
            control.cancel.check()?;
            Ok(fit_joint(grid.surface(), seen, *node))
        };
        let fitted = nodes.par_iter().map(fit).collect::<Result<Vec<_>, ExtractError>>()?;
        for (&node, joint) in nodes.iter().zip(fitted).filter_map(|(node, joint)| Some((node, joint?))) {
            place(grid, network, node, &joint);
        }
        nodes = network.contract_close(true);
    }
    Ok(())
}

/// Leads the branches of a joint along their fitted ways.
fn place(grid: &TriangleGrid<'_>, network: &mut Network, node: usize, joint: &FittedJoint) {
    let Some(anchor) = &mut network.nodes[node].anchor else { return };
    let moved = joint.centre - std::mem::replace(&mut anchor.point, joint.centre);
    let firm = |way: &&FittedLimb| !way.hidden;
    let radius = |way: &FittedLimb| way.limb.radii[1] * way.inscribed;
    let widest = joint.limbs.iter().filter(firm).map(radius).fold(0.0, f64::max);
    if widest > 0.0 {
        anchor.radius = widest;
    }
    aim_bulges(grid, network, &network.incident(node), &joint.centre);
    for way in &joint.limbs {
        network.oriented(way.track, way.at_end, |track| {
            let firm = track.stations.len() - way.replaced;
            if way.hidden {
                carry_hidden(&mut track.stations, firm, &moved);
                return;
            }
            track.stations.truncate(firm);
            let Some(firm) = track.stations.last().cloned() else { return };
            let count = (way.limb.length() / (SPACING * way.limb.radii[0])).round().clamp(1.0, 64.0) as usize;
            for i in 1..count {
                let t = i as f64 / count as f64;
                let Some(tangent) = nalgebra::Unit::try_new(way.limb.slope(t), 0.0) else { continue };
                let mut station = Station::rough(way.limb.at(t), tangent, way.limb.radius(t), firm.ring);
                station.radius = way.limb.radius(t) * way.inscribed;
                station.sight = Sight::Partial;
                track.stations.push(station);
            }
        });
    }
}

/// What is no vessel: a closed blob with one short branch, a sheet without a lumen.
pub(in crate::centerline) fn refuse_blob(
    surface: &Surface,
    graph: &ComponentGraph,
) -> Result<(), ExtractError> {
    /// Least volume of a lumen against its wall's area times the line's radius; a tube has a half.
    const LUMEN: f64 = 0.02;
    let radii = graph.branches.iter().flat_map(|branch| branch.radii.iter().copied());
    let widest = radii.fold(0.0, f64::max);
    if surface.volume() < LUMEN * surface.area() * widest {
        let detail = "it encloses no lumen: it is a sheet".to_owned();
        return Err(ExtractError::NotTubular { detail });
    }
    let [branch] = &graph.branches[..] else { return Ok(()) };
    let is_blob = surface.open_cuts() < 2 && branch.from != branch.to && branch.length() < 2.5 * widest;
    if is_blob {
        let detail = format!("its line would be {:.3} long at a radius of {widest:.3}", branch.length());
        return Err(ExtractError::NotTubular { detail });
    }
    Ok(())
}
