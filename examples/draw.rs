//! Draws a mesh and the centerline that was extracted from it.
//!
//!     cargo run --release --example draw -- MESH RESULT.json PICTURE.png [DEGREES [PIXELS]]
//!
//! An orthographic view along the mesh's shortest axis, turned by DEGREES about the upright one; the longer side
//! has PIXELS (1600).
//! The surface is glass; the line's colour is its radius, from blue (thin) to yellow (wide); ends
//! are white, junctions orange.

use std::error::Error;
use std::fs;
use std::path::Path;

use nalgebra::{Matrix3, Point3, Rotation3, Unit, Vector3};
use rayon::prelude::*;
use rosaline::centerline::Centerline;
use rosaline::mesh::TriangleMesh;
use rosaline::mesh::format::{Hint, Limits, read};
use rosaline::output::read_json;

/// Longer side of the picture in pixels, unless told otherwise.
const SIZE: usize = 1600;

/// Samples a pixel along each side.
const SAMPLES: usize = 3;

/// Share of the picture's shorter side that stays free around the vessel.
const MARGIN: f64 = 0.05;

/// Half widths of the line and of its nodes, in pixels.
const LINE: f64 = 3.2;
const END: f64 = 6.5;
const JUNCTION: f64 = 5.5;

/// Share of the surface's opacity that is left before the line.
const BEFORE_LINE: f64 = 0.35;

/// Colours are linear light.
type Colour = Vector3<f64>;

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let (mesh, result, picture, degrees, size) = match words.as_slice() {
        [mesh, result, picture] => (mesh, result, picture, 0.0, SIZE),
        [mesh, result, picture, degrees] => (mesh, result, picture, degrees.parse()?, SIZE),
        [mesh, result, picture, degrees, size] => (mesh, result, picture, degrees.parse()?, size.parse()?),
        _ => return Err("usage: draw MESH RESULT.json PICTURE.png [DEGREES [PIXELS]]".into()),
    };
    let extension = Path::new(mesh).extension().and_then(|text| text.to_str());
    let (mesh, _) = read(&fs::read(mesh)?, Hint { extension, content_type: None }, &Limits::default())?;
    let line = read_json(&fs::read(result)?)?.centerline()?;
    let camera = Camera::on(&mesh, f64::to_radians(degrees), size).ok_or("the mesh has no vertices")?;
    let mut canvas = Canvas::new(&camera);
    canvas.draw_line(&camera, &line);
    let mut fragments = fragments(&camera, &mesh);
    canvas.blend(&mut fragments);
    fs::write(picture, png(camera.width / SAMPLES, camera.height / SAMPLES, &canvas.pixels(&camera))?)?;
    Ok(())
}

/// An orthographic view; samples count from the upper left, depth grows towards the eye.
struct Camera {
    /// Rows: right, up, towards the eye.
    axes: Matrix3<f64>,
    middle: Vector3<f64>,
    /// Samples in a unit of length.
    scale: f64,
    width: usize,
    height: usize,
}

impl Camera {
    /// Looks at the whole mesh along its shortest principal axis.
    fn on(mesh: &TriangleMesh, turn: f64, size: usize) -> Option<Self> {
        let count = mesh.vertices.len() as f64;
        let mean: Vector3<f64> =
            mesh.vertices.iter().map(|vertex| vertex.coords).sum::<Vector3<f64>>() / count;
        let spread = |vertex: &Point3<f64>| (vertex.coords - mean) * (vertex.coords - mean).transpose();
        let covariance: Matrix3<f64> = mesh.vertices.iter().map(spread).sum();
        let eigen = covariance.symmetric_eigen();
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        let right = eigen.eigenvectors.column(order[0]).into_owned();
        let up = eigen.eigenvectors.column(order[1]).into_owned();
        let turned = Rotation3::from_axis_angle(&Unit::new_normalize(up), turn) * right;
        let axes = Matrix3::from_rows(&[turned.transpose(), up.transpose(), turned.cross(&up).transpose()]);
        let seen: Vec<_> = mesh.vertices.iter().map(|vertex| axes * vertex.coords).collect();
        let first = *seen.first()?;
        let (low, high) = seen.iter().fold((first, first), |(low, high), at| (low.inf(at), high.sup(at)));
        let (extent, long) = (high - low, (size * SAMPLES) as f64);
        let scale = long * (1.0 - 2.0 * MARGIN) / extent.x.max(extent.y);
        let side = |extent: f64| {
            let samples = extent * scale + 2.0 * MARGIN * long;
            (samples / SAMPLES as f64).round() as usize * SAMPLES
        };
        Some(Self { axes, middle: (low + high) / 2.0, scale, width: side(extent.x), height: side(extent.y) })
    }

    /// Where a point is seen: column, row and depth, in samples.
    fn see(&self, point: &Point3<f64>) -> Vector3<f64> {
        let seen = (self.axes * point.coords - self.middle) * self.scale;
        Vector3::new(seen.x + self.width as f64 / 2.0, self.height as f64 / 2.0 - seen.y, seen.z)
    }
}

/// Light from the upper left, before the picture.
fn light() -> Vector3<f64> {
    Vector3::new(-0.45, 0.6, 0.66).normalize()
}

/// What is opaque: the colour and depth of each sample.
struct Canvas {
    width: usize,
    height: usize,
    colours: Vec<Colour>,
    depths: Vec<f64>,
}

impl Canvas {
    fn new(camera: &Camera) -> Self {
        let (width, height) = (camera.width, camera.height);
        let paper = |row: usize| mix(srgb(0xffffff), srgb(0xe9eef4), row as f64 / height as f64);
        let colours = (0..width * height).map(|place| paper(place / width)).collect();
        Self { width, height, colours, depths: vec![f64::NEG_INFINITY; width * height] }
    }

    fn draw_line(&mut self, camera: &Camera, line: &Centerline) {
        let radii = || line.branches.iter().flat_map(|branch| branch.radii.iter().copied());
        let low = radii().fold(f64::INFINITY, f64::min);
        let high = radii().fold(low, f64::max);
        let share = |radius: f64| if high > low { (radius - low) / (high - low) } else { 0.5 };
        let half = LINE * SAMPLES as f64;
        for branch in &line.branches {
            for (points, radii) in branch.points.windows(2).zip(branch.radii.windows(2)) {
                let (from, to) = (camera.see(&points[0]), camera.see(&points[1]));
                let beads = ((to - from).norm() / (0.2 * half)).ceil().max(1.0) as usize;
                for bead in 0..=beads {
                    let along = bead as f64 / beads as f64;
                    let colour = scale(share(radii[0] + along * (radii[1] - radii[0])));
                    self.sphere(from + (to - from) * along, half, colour);
                }
            }
        }
        for (node, place) in line.nodes.iter().zip(0..) {
            let end = line.degree(place) == 1;
            let (half, colour) = if end { (END, srgb(0xffffff)) } else { (JUNCTION, srgb(0xff8a1f)) };
            // A dark ring behind, so that it stands off the line.
            let centre = camera.see(&node.position);
            self.sphere(centre, (half + 1.6) * SAMPLES as f64, srgb(0x1d2430));
            self.sphere(centre + Vector3::z() * (3.0 * half), half * SAMPLES as f64, colour);
        }
    }

    /// A ball, lit.
    fn sphere(&mut self, centre: Vector3<f64>, radius: f64, colour: Colour) {
        let clamp = |value: f64, most: usize| value.clamp(0.0, most as f64) as usize;
        for row in clamp(centre.y - radius, self.height)..clamp(centre.y + radius + 1.0, self.height) {
            for column in clamp(centre.x - radius, self.width)..clamp(centre.x + radius + 1.0, self.width) {
                let x = (column as f64 + 0.5 - centre.x) / radius;
                let y = (centre.y - row as f64 - 0.5) / radius;
                let left = 1.0 - x * x - y * y;
                let place = row * self.width + column;
                if left > 0.0 && centre.z + radius * left.sqrt() > self.depths[place] {
                    self.depths[place] = centre.z + radius * left.sqrt();
                    let lit = light().dot(&Vector3::new(x, y, left.sqrt())).max(0.0);
                    self.colours[place] = colour * (0.45 + 0.6 * lit);
                }
            }
        }
    }

    /// Lays the glass over what is behind it, the farthest first.
    fn blend(&mut self, fragments: &mut [Fragment]) {
        fragments.par_sort_by(|a, b| a.place.cmp(&b.place).then(a.depth.total_cmp(&b.depth)));
        for fragment in fragments {
            let place = fragment.place as usize;
            if f64::from(fragment.depth) > self.depths[place] {
                let colour = fragment.colour.map(f64::from).into();
                // The glass is clearer before the line, for the line is what the picture is of.
                let veil = if self.depths[place] > f64::NEG_INFINITY { BEFORE_LINE } else { 1.0 };
                self.colours[place] = mix(self.colours[place], colour, veil * f64::from(fragment.opacity));
            }
        }
    }

    /// The picture's bytes, three a pixel: each the mean of its samples.
    fn pixels(&self, camera: &Camera) -> Vec<u8> {
        let (width, height) = (camera.width / SAMPLES, camera.height / SAMPLES);
        let pixel = |place: usize| {
            let (row, column) = (place / width * SAMPLES, place % width * SAMPLES);
            let samples = (0..SAMPLES * SAMPLES).map(|sample| {
                self.colours[(row + sample / SAMPLES) * self.width + column + sample % SAMPLES]
            });
            let mean = samples.sum::<Colour>() / (SAMPLES * SAMPLES) as f64;
            <[f64; 3]>::from(mean).map(encode)
        };
        (0..width * height).flat_map(pixel).collect()
    }
}

/// A sample of the surface.
struct Fragment {
    place: u32,
    depth: f32,
    colour: [f32; 3],
    opacity: f32,
}

/// The samples of every triangle.
fn fragments(camera: &Camera, mesh: &TriangleMesh) -> Vec<Fragment> {
    let normals = normals(mesh);
    let seen: Vec<_> = mesh.vertices.par_iter().map(|vertex| camera.see(vertex)).collect();
    let of = |triangle: &[u32; 3]| {
        let corners = triangle.map(|vertex| seen[vertex as usize]);
        let normals = triangle.map(|vertex| camera.axes * normals[vertex as usize]);
        rasterise(camera, &corners, &normals)
    };
    mesh.triangles.par_iter().flat_map_iter(of).collect()
}

fn rasterise(camera: &Camera, corners: &[Vector3<f64>; 3], normals: &[Vector3<f64>; 3]) -> Vec<Fragment> {
    let [a, b, c] = corners;
    let side = |from: &Vector3<f64>, to: &Vector3<f64>, x: f64, y: f64| {
        (to.x - from.x) * (y - from.y) - (to.y - from.y) * (x - from.x)
    };
    let area = side(a, b, c.x, c.y);
    let mut fragments = Vec::new();
    if area == 0.0 {
        return fragments;
    }
    let (low, high) = (a.inf(b).inf(c), a.sup(b).sup(c));
    let bound = |value: f64, most: usize| value.clamp(0.0, most as f64) as usize;
    for row in bound(low.y, camera.height)..bound(high.y + 1.0, camera.height) {
        for column in bound(low.x, camera.width)..bound(high.x + 1.0, camera.width) {
            let (x, y) = (column as f64 + 0.5, row as f64 + 0.5);
            let shares = [side(b, c, x, y), side(c, a, x, y), side(a, b, x, y)].map(|share| share / area);
            if shares.iter().all(|&share| share >= 0.0) {
                let normal: Vector3<f64> =
                    normals.iter().zip(shares).map(|(normal, share)| normal * share).sum();
                let depth: f64 = corners.iter().zip(shares).map(|(corner, share)| corner.z * share).sum();
                let (colour, opacity) = glass(&normal.normalize());
                fragments.push(Fragment {
                    place: (row * camera.width + column) as u32,
                    depth: depth as f32,
                    colour: [colour.x, colour.y, colour.z].map(|value| value as f32),
                    opacity: opacity as f32,
                });
            }
        }
    }
    fragments
}

/// Colour and opacity of the surface where `normal` stands: clear towards the eye, dense at the rim.
fn glass(normal: &Vector3<f64>) -> (Colour, f64) {
    let rim = (1.0 - normal.z.abs()).powf(1.8);
    let back = normal.z < 0.0;
    let normal = if back { -normal } else { *normal };
    let lit = light().dot(&normal).max(0.0);
    let gleam = (light() + Vector3::z()).normalize().dot(&normal).max(0.0).powi(60);
    let body = mix(srgb(0xe88f86), srgb(0x93202c), rim) * (0.6 + 0.5 * lit);
    if back {
        return (body * 0.9, 0.10 + 0.3 * rim);
    }
    (mix(body, srgb(0xffffff), 0.75 * gleam), 0.30 + 0.60 * rim + 0.3 * gleam)
}

/// Normals of the vertices: the mean of their triangles' by area.
fn normals(mesh: &TriangleMesh) -> Vec<Vector3<f64>> {
    let mut normals = vec![Vector3::zeros(); mesh.vertices.len()];
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|vertex| mesh.vertices[vertex as usize]);
        let normal = (b - a).cross(&(c - a));
        for &vertex in triangle {
            normals[vertex as usize] += normal;
        }
    }
    normals.iter().map(|normal| normal.try_normalize(0.0).unwrap_or_else(Vector3::z)).collect()
}

/// From blue over green to yellow.
fn scale(share: f64) -> Colour {
    let stops = [0x2b2f9e, 0x1f6fc4, 0x14a39a, 0x74c64a, 0xf6e13a].map(srgb);
    let at = share.clamp(0.0, 1.0) * (stops.len() - 1) as f64;
    let below = (at as usize).min(stops.len() - 2);
    mix(stops[below], stops[below + 1], at - below as f64)
}

fn mix(from: Colour, to: Colour, share: f64) -> Colour {
    from + (to - from) * share
}

/// Linear light of a colour as the web writes it (IEC 61966-2-1).
fn srgb(hexadecimal: u32) -> Colour {
    Colour::from([16, 8, 0].map(|shift| {
        let value = f64::from(hexadecimal >> shift & 0xff) / 255.0;
        if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
    }))
}

fn encode(value: f64) -> u8 {
    let value = value.clamp(0.0, 1.0);
    let curved = if value <= 0.003_130_8 { 12.92 * value } else { 1.055 * value.powf(1.0 / 2.4) - 0.055 };
    (curved * 255.0).round() as u8
}

/// A PNG (ISO/IEC 15948) of 8-bit RGB pixels.
fn png(width: usize, height: usize, pixels: &[u8]) -> Result<Vec<u8>, Box<dyn Error>> {
    use std::io::Write as _;
    let mut rows = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::best());
    let mut above = vec![0; 3 * width];
    for row in pixels.chunks(3 * width) {
        // Filter type 2: differences to the row above.
        let filtered = row.iter().zip(&above).map(|(value, above): (&u8, &u8)| value.wrapping_sub(*above));
        rows.write_all(&[2])?;
        rows.write_all(&filtered.collect::<Vec<_>>())?;
        above.copy_from_slice(row);
    }
    let mut header = Vec::new();
    header.extend(u32::try_from(width)?.to_be_bytes());
    header.extend(u32::try_from(height)?.to_be_bytes());
    // 8 bits, RGB, deflate, adaptive filters, not interlaced.
    header.extend([8, 2, 0, 0, 0]);
    let mut bytes = b"\x89PNG\r\n\x1a\n".to_vec();
    for (name, body) in [(b"IHDR", header), (b"IDAT", rows.finish()?), (b"IEND", Vec::new())] {
        bytes.extend(u32::try_from(body.len())?.to_be_bytes());
        let mut crc = flate2::Crc::new();
        crc.update(name);
        crc.update(&body);
        bytes.extend(name);
        bytes.extend(body);
        bytes.extend(crc.sum().to_be_bytes());
    }
    Ok(bytes)
}
