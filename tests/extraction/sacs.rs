//! Sacs: aneurysms on the side of a vessel and on the apex of a fork.

use nalgebra::{Point3, Vector3};
use rosaline::mesh::TriangleMesh;

use crate::lines::{ends_and_junctions, line_of, parts_and_loops};
use crate::surfaces::{from_segment, implicit, mapped, turn};

/// Vessels of such radii from the origin, and a sac of such a centre and radius whose neck leads there, with blebs of such
/// centres and radii; closed, on voxels of such a side.
struct Case {
    legs: Vec<(Vector3<f64>, f64)>,
    sac: (Vector3<f64>, f64),
    blebs: Vec<(Vector3<f64>, f64)>,
    neck: f64,
    step: f64,
}

impl Case {
    fn mesh(&self) -> TriangleMesh {
        let middle = self.sac.0;
        let field = |point: &Point3<f64>| {
            let leg = |(tip, radius): &(Vector3<f64>, f64)| {
                from_segment(point, Point3::origin(), Point3::from(*tip)) - radius
            };
            let ball = |(middle, radius): &(Vector3<f64>, f64)| (point.coords - middle).norm() - radius;
            let neck = from_segment(point, Point3::origin(), Point3::from(middle)) - self.neck;
            let balls = self.blebs.iter().chain([&self.sac]).map(ball);
            self.legs.iter().map(leg).chain(balls).fold(neck, f64::min)
        };
        let reach = |side: f64| {
            let tips = self
                .legs
                .iter()
                .chain([&self.sac])
                .chain(&self.blebs)
                .map(|(tip, radius)| tip.add_scalar(side * radius));
            let far = tips.map(|tip| tip * side).fold(Vector3::repeat(f64::MIN), |a, b| a.sup(&b));
            (far * side).add_scalar(side * 1.1 * self.step)
        };
        implicit(reach(-1.0).into(), reach(1.0).into(), self.step, field)
    }

    /// The line of the mesh as it is and turned: an end at the pole of each leg and of the dome, one joint, within 0.4
    /// radii of the widest leg from where all axes meet.
    fn check(&self, name: &str) {
        for (turned, mesh) in [(false, self.mesh()), (true, mapped(&self.mesh(), |point| turn() * point))] {
            let found = line_of(&mesh);
            let ends = ends_and_junctions(&found.centerline).0;
            assert_eq!(
                (ends, parts_and_loops(&found.centerline)),
                (self.legs.len() + 1, (1, 0)),
                "{name} {turned}"
            );
            let place = |coords: Vector3<f64>| {
                if turned { turn() * Point3::from(coords) } else { Point3::from(coords) }
            };
            let nearest = |place: Point3<f64>| {
                let away = found.centerline.nodes.iter().map(|node| (node.position - place).norm());
                away.fold(f64::INFINITY, f64::min)
            };
            for (tip, radius) in self.legs.iter().chain([&self.sac]) {
                let away = nearest(place(tip + tip.normalize() * *radius));
                assert!(away < 0.25 * radius, "{name} {turned}: no end near {tip:?}, but {away} off");
            }
            let widest = self.legs.iter().map(|leg| leg.1).fold(0.0, f64::max);
            let joint = nearest(place(Vector3::zeros()));
            assert!(joint < 0.4 * widest, "{name} {turned}: the joint is {joint} off");
            let joints = found.centerline.nodes.len() - ends;
            assert_eq!(joints, 1, "{name} {turned}");
        }
    }
}

fn lean(degrees: f64, length: f64) -> Vector3<f64> {
    let (sin, cos) = degrees.to_radians().sin_cos();
    Vector3::new(length * sin, 0.0, length * cos)
}

/// The line left for the dome from one of the two legs beside it, or ended on its side.
#[test]
fn a_sac_on_the_apex_of_a_fork_leaves_from_the_fork() {
    for (legs, sac, neck, step) in [
        ([85.0, -85.0], (lean(4.0, 5.6), 2.6), 1.3, 0.4),
        ([70.0, -80.0], (lean(0.0, 4.6), 1.9), 1.2, 0.3),
        ([95.0, -90.0], (lean(-10.0, 7.2), 4.6), 1.4, 0.4),
    ] {
        let daughters = [lean(legs[0], 15.0), lean(legs[1], 15.0)];
        let legs = vec![(lean(180.0, 14.0), 2.0), (daughters[0], 1.5), (daughters[1], 1.4)];
        Case { legs, sac, blebs: Vec::new(), neck, step }
            .check(&format!("sac of {} on voxels of {step}", sac.1));
    }
}

/// Where it is much wider than its vessel the front begins in the sac, and passes its wall from any side.
#[test]
fn a_wide_sac_on_the_side_of_a_vessel_stands_square_to_it() {
    for (radius, neck) in [(2.2, 1.5), (4.0, 1.2), (5.2, 1.4)] {
        let legs = vec![(lean(90.0, 20.0), 2.0), (lean(-90.0, 20.0), 2.0)];
        let sac = (lean(0.0, 2.0 + 0.9 * radius), radius);
        Case { legs, sac, blebs: Vec::new(), neck, step: 0.4 }.check(&format!("sac of {radius}"));
    }
}

/// The holes of blebs counted as the neck's, and the joint slid along its vessel.
#[test]
fn a_bleb_on_a_sac_leaves_its_neck_where_it_is() {
    let legs = || vec![(lean(90.0, 18.0), 2.0), (lean(-90.0, 18.0), 2.0)];
    let (middle, radius) = (lean(0.0, 5.2), 3.6);
    let bleb = |degrees: f64, size: f64| (middle + lean(degrees, radius), size);
    for (name, blebs) in
        [("one", vec![bleb(80.0, 1.2)]), ("three", vec![bleb(60.0, 1.0), bleb(-85.0, 1.1), bleb(105.0, 0.9)])]
    {
        Case { legs: legs(), sac: (middle, radius), blebs, neck: 1.5, step: 0.35 }.check(name);
    }
}

/// The wall of the stalk between a joint and a dome is no other branch's: the joint slid toward the dome.
#[test]
fn a_vessel_that_widens_to_its_end_keeps_the_joint_before_it() {
    for (end, angle) in [(3.4, 20.0), (3.9, -30.0)] {
        let legs = vec![(lean(-90.0, 16.0), 2.0), (lean(angle, 15.0), 1.3)];
        let sac = (lean(90.0, 9.0), end);
        Case { legs, sac, blebs: Vec::new(), neck: 2.0, step: 0.35 }.check(&format!("an end of {end}"));
    }
}

/// Its axis led to a joint far along the vessel.
#[test]
fn a_sac_on_a_stalk_that_bends_begins_where_its_stalk_does() {
    let bend = [(0.0, 0.0), (0.0, 3.7), (0.6, 4.3), (4.2, 4.3)].map(|(x, z)| Point3::new(x, 0.0, z));
    let field = |point: &Point3<f64>| {
        let vessel = from_segment(point, Point3::new(-16.0, 0.0, 0.0), Point3::new(16.0, 0.0, 0.0)) - 2.0;
        let stalk = bend.windows(2).map(|pair| from_segment(point, pair[0], pair[1]) - 0.8);
        stalk.fold(vessel.min((point - bend[3]).norm() - 1.7), f64::min)
    };
    let mesh = implicit([-18.3, -2.3, -2.3], [18.3, 2.3, 7.0], 0.3, field);
    let found = line_of(&mesh);
    let (ends, joints) = ends_and_junctions(&found.centerline);
    assert_eq!((ends, joints), (3, 1));
    let away = found.centerline.nodes.iter().map(|node| node.position.coords.norm());
    let joint = away.fold(f64::INFINITY, f64::min);
    assert!(joint < 0.8, "the joint is {joint} off");
}
