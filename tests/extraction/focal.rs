//! Places where a vessel narrows or widens within about a diameter.

use nalgebra::Point3;

use crate::lines::line_of;
use crate::surfaces::implicit;

/// A tube of radius 2 along z whose throat at z = 20.3, of radius 1, lies aside.
#[test]
fn the_line_runs_through_a_throat_that_lies_aside() {
    const ASIDE: f64 = 0.8;
    let near = |z: f64| (-((z - 20.3) / 2.0_f64).powi(2)).exp();
    for step in [0.25, 0.4] {
        let field = |p: &Point3<f64>| {
            let wall = (p.x - ASIDE * near(p.z)).hypot(p.y) - (2.0 - near(p.z));
            wall.max(-p.z).max(p.z - 40.0)
        };
        let found = line_of(&implicit([-3.01, -3.013, -1.017], [3.0, 3.0, 41.0], step, field)).centerline;
        let branch = &found.branches[0];
        let all = || branch.points.iter().zip(&branch.radii);
        let throat = all().min_by(|a, b| a.1.total_cmp(b.1)).unwrap();
        assert!((throat.1 - 1.0).abs() < 0.05 && (throat.0.z - 20.3).abs() < 0.3, "{step}: {throat:?}");
        assert!((throat.0.x - ASIDE).hypot(throat.0.y) < 0.05, "{step}: {}", throat.0);
        let off = |p: &Point3<f64>| (p.x - ASIDE * near(p.z)).hypot(p.y);
        let farthest = all().map(|(point, _)| off(point)).fold(0.0, f64::max);
        assert!(farthest < 0.25, "{step}: {farthest}");
    }
}
