//! The result as a document: the schema `rosaline.centerline/1`.

use std::collections::BTreeMap;

use nalgebra::Point3;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::centerline::{Branch, Centerline, Extraction, Node, NodeKind, Parameters};
use crate::mesh::Units;

use super::parameters::{ParameterValue, parameter_value};
use super::schemas::{name_schema, points_schema, position_schema, units_schema};
use super::{OutputError, QualityRecord};

/// The value of the member `schema`.
pub const SCHEMA: &str = "rosaline.centerline/1";

/// A centerline with where it came from. Lengths and positions are in the input's own unit
/// and frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ResultDocument {
    #[schema(schema_with = name_schema)]
    pub schema: String,
    #[schema(schema_with = units_schema)]
    pub units: String,
    pub source: SourceRecord,
    pub method: MethodRecord,
    /// Ends and junctions; `id` is the place in this array.
    pub nodes: Vec<NodeRecord>,
    /// Curves between nodes; `id` is the place in this array.
    pub branches: Vec<BranchRecord>,
    /// In every result of an extraction. Only the known line that `rosaline phantom` writes has none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = QualityRecord, required = true)]
    pub quality: Option<QualityRecord>,
    /// What the user should know about an otherwise successful result.
    pub warnings: Vec<WarningRecord>,
}

/// The input surface, counted after welding equal vertices and before any repair.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SourceRecord {
    /// The name of the file, where the sender gave one.
    #[schema(required = true)]
    pub name: Option<String>,
    /// The format that the reader found the content to be.
    #[schema(example = "stl")]
    pub format: String,
    /// SHA-256 of the input's bytes, in lower-case hexadecimal.
    #[schema(min_length = 64, max_length = 64)]
    pub sha256: String,
    pub vertices: usize,
    pub triangles: usize,
    pub components: usize,
    /// Sum over the components, openings capped.
    pub genus: usize,
    /// Boundary loops.
    pub openings: usize,
    /// Diagonal of the bounding box.
    pub diagonal: f64,
}

/// What made the line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct MethodRecord {
    /// `default` or `paper`; `phantom` for the known centerline of a made surface.
    #[schema(example = "default")]
    pub preset: String,
    /// Every parameter that the preset uses, with the value it had; points where any were given.
    pub parameters: BTreeMap<String, ParameterValue>,
    /// Version of Rosaline.
    #[schema(example = "0.1.0")]
    pub version: String,
}

/// An end or a junction.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct NodeRecord {
    pub id: usize,
    /// `end` or `junction`.
    #[schema(example = "end")]
    pub kind: KindRecord,
    #[schema(schema_with = position_schema)]
    pub position: [f64; 3],
    /// Radius of the largest inscribed sphere.
    pub radius: f64,
    /// Radius of the circle that has the area of the widest branch's section here.
    #[serde(default)]
    #[schema(required = true)]
    pub equivalent_radius: f64,
    /// How many branch ends meet here; a branch that starts and ends here counts twice.
    pub degree: usize,
}

/// What a node is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum KindRecord {
    /// The vessel ends here.
    End,
    /// Branches meet here, or this is the seam of a ring without junctions.
    Junction,
}

/// A curve between two nodes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct BranchRecord {
    pub id: usize,
    /// Id of the node at the first point.
    pub from: usize,
    /// Id of the node at the last point.
    pub to: usize,
    /// Along the points.
    pub length: f64,
    /// At least two; the first and the last are the nodes' positions.
    #[schema(schema_with = points_schema)]
    pub points: Vec<[f64; 3]>,
    /// Radius of the largest inscribed sphere at each point.
    pub radii: Vec<f64>,
    /// Radius of the circle that has the section's area at each point; none is below the inscribed one.
    #[serde(default)]
    #[schema(required = true)]
    pub equivalent_radii: Vec<f64>,
}

/// Something found about the surface or the line.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct WarningRecord {
    /// A stable word.
    pub code: String,
    /// For people.
    pub detail: String,
}

/// What is known of the input beside its surface.
#[derive(Debug, Clone, Copy)]
pub struct Source<'a> {
    /// File name, if the sender gave one.
    pub name: Option<&'a str>,
    /// Name of the format that was read.
    pub format: &'a str,
    /// Lower-case hexadecimal SHA-256 of the input's bytes.
    pub sha256: &'a str,
    pub units: Units,
}

impl ResultDocument {
    /// The document of an extraction.
    pub fn new(extraction: &Extraction, source: &Source<'_>, parameters: &Parameters) -> Self {
        let method = MethodRecord {
            preset: parameters.preset().name().to_owned(),
            parameters: parameters
                .iter()
                .map(|(spec, value)| (spec.name.to_owned(), parameter_value(spec.kind, value)))
                .chain(parameters.points().map(|(spec, points)| (spec.name.to_owned(), points.into())))
                .collect(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
        };
        let mut document = Self::with_method(extraction, source, method);
        document.warnings.extend(parameters.unused().map(|(spec, _)| WarningRecord {
            code: "unused-parameter".to_owned(),
            detail: format!("{} was set, and the preset {} does not use it", spec.name, parameters.preset()),
        }));
        document
    }

    /// The document of a centerline that another `method` made.
    pub fn with_method(extraction: &Extraction, source: &Source<'_>, method: MethodRecord) -> Self {
        let Extraction { centerline, surface, quality, warnings } = extraction;
        let source_record = SourceRecord {
            name: source.name.map(str::to_owned),
            format: source.format.to_owned(),
            sha256: source.sha256.to_owned(),
            vertices: surface.vertices,
            triangles: surface.triangles,
            components: surface.components,
            genus: surface.genus,
            openings: surface.openings,
            diagonal: surface.diagonal,
        };
        let warnings = warnings
            .iter()
            .map(|warning| WarningRecord { code: warning.code.to_owned(), detail: warning.detail.clone() });
        Self {
            schema: SCHEMA.to_owned(),
            units: source.units.name().to_owned(),
            source: source_record,
            method,
            nodes: node_records(centerline),
            branches: centerline.branches.iter().enumerate().map(branch_record).collect(),
            quality: quality.as_ref().map(QualityRecord::from),
            warnings: warnings.collect(),
        }
    }

    /// The graph in the document.
    ///
    /// # Errors
    /// [`OutputError::Inconsistent`] when a branch names a node that is not there, or has not
    /// one radius for each of at least two points.
    pub fn centerline(&self) -> Result<Centerline, OutputError> {
        let nodes = self.nodes.iter().map(|node| Node {
            kind: match node.kind {
                KindRecord::End => NodeKind::End,
                KindRecord::Junction => NodeKind::Junction,
            },
            position: Point3::from(node.position),
            radius: node.radius,
            equivalent_radius: node.equivalent_radius.max(node.radius),
        });
        let branches: Result<Vec<_>, _> =
            self.branches.iter().map(|record| branch(record, self.nodes.len())).collect();
        Ok(Centerline { nodes: nodes.collect(), branches: branches? })
    }
}

fn node_records(centerline: &Centerline) -> Vec<NodeRecord> {
    let mut degrees = vec![0; centerline.nodes.len()];
    for branch in &centerline.branches {
        degrees[branch.from] += 1;
        degrees[branch.to] += 1;
    }
    let record = |(id, (node, degree)): (usize, (&Node, usize))| NodeRecord {
        id,
        kind: match node.kind {
            NodeKind::End => KindRecord::End,
            NodeKind::Junction => KindRecord::Junction,
        },
        position: node.position.into(),
        radius: node.radius,
        equivalent_radius: node.equivalent_radius,
        degree,
    };
    centerline.nodes.iter().zip(degrees).enumerate().map(record).collect()
}

fn branch_record((id, branch): (usize, &Branch)) -> BranchRecord {
    BranchRecord {
        id,
        from: branch.from,
        to: branch.to,
        length: branch.length(),
        points: branch.points.iter().map(|&point| point.into()).collect(),
        radii: branch.radii.clone(),
        equivalent_radii: branch.equivalent_radii.clone(),
    }
}

fn branch(record: &BranchRecord, nodes: usize) -> Result<Branch, OutputError> {
    let &BranchRecord { id, from, to, ref points, ref radii, ref equivalent_radii, .. } = record;
    let detail = if let Some(node) = [from, to].into_iter().find(|&node| node >= nodes) {
        format!("branch {id} names node {node} and there are {nodes} nodes")
    } else if points.len() < 2 || points.len() != radii.len() {
        format!("branch {id} has {} points and {} radii", points.len(), radii.len())
    } else if ![0, points.len()].contains(&equivalent_radii.len()) {
        format!("branch {id} has {} points and {} equivalent radii", points.len(), equivalent_radii.len())
    } else {
        let points = points.iter().map(|&point| Point3::from(point)).collect();
        // A document that knows spheres alone has circles for sections.
        let branch = Branch::new(from, to, points, radii.clone());
        return Ok(match equivalent_radii.len() {
            0 => branch,
            _ => Branch { equivalent_radii: equivalent_radii.clone(), ..branch },
        });
    };
    Err(OutputError::Inconsistent { detail })
}

#[cfg(test)]
pub(in crate::output) mod tests {
    use crate::centerline::{SurfaceSummary, Warning};

    use super::*;

    /// One vessel that forks: a junction at the origin, ends at -x, +x+y and +x-y.
    pub(in crate::output) fn fork() -> ResultDocument {
        of(&Parameters::default())
    }

    fn of(parameters: &Parameters) -> ResultDocument {
        let node = |kind, x: f64, y: f64, radius| Node {
            kind,
            position: Point3::new(x, y, 0.0),
            radius,
            equivalent_radius: 1.5 * radius,
        };
        let nodes = vec![
            node(NodeKind::End, -3.0, 0.0, 1.0),
            node(NodeKind::Junction, 0.0, 0.0, 0.9),
            node(NodeKind::End, 4.0, 3.0, 0.5),
            node(NodeKind::End, 4.0, -3.0, 0.25),
        ];
        let branch = |from: usize, to: usize| {
            let middle = nalgebra::center(&nodes[from].position, &nodes[to].position);
            let points = vec![nodes[from].position, middle, nodes[to].position];
            Branch::new(from, to, points, vec![nodes[from].radius, 0.6, nodes[to].radius])
        };
        let branches = vec![branch(0, 1), branch(1, 2), branch(1, 3)];
        let extraction = Extraction {
            centerline: Centerline { nodes, branches },
            surface: SurfaceSummary {
                vertices: 100,
                triangles: 196,
                components: 1,
                genus: 0,
                openings: 0,
                diagonal: 10.0,
            },
            quality: None,
            warnings: vec![Warning {
                code: "degenerate-triangles",
                detail: "2 triangles dropped".to_owned(),
            }],
        };
        let source = Source {
            name: Some("fork.stl"),
            format: "stl",
            sha256: "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855",
            units: Units::Millimetres,
        };
        ResultDocument::new(&extraction, &source, parameters)
    }

    #[test]
    fn degrees_lengths_and_ids_come_from_the_graph() {
        let document = fork();
        let degrees: Vec<_> = document.nodes.iter().map(|node| node.degree).collect();
        assert_eq!(degrees, [1, 3, 1, 1]);
        let lengths: Vec<_> = document.branches.iter().map(|branch| branch.length).collect();
        assert_eq!(lengths, [3.0, 5.0, 5.0]);
        assert!(document.branches.iter().enumerate().all(|(place, branch)| branch.id == place));
        assert_eq!(document.centerline().unwrap().branches[2].to, 3);
    }

    #[test]
    fn a_loop_at_one_node_counts_twice() {
        let point = |x, y| Point3::new(x, y, 0.0);
        let centerline = Centerline {
            nodes: vec![Node {
                kind: NodeKind::Junction,
                position: point(1.0, 0.0),
                radius: 0.1,
                equivalent_radius: 0.1,
            }],
            branches: vec![Branch::new(
                0,
                0,
                vec![point(1.0, 0.0), point(0.0, 1.0), point(-1.0, 0.0), point(1.0, 0.0)],
                vec![0.1; 4],
            )],
        };
        assert_eq!(node_records(&centerline)[0].degree, 2);
    }

    #[test]
    fn flags_are_booleans_and_the_parameters_are_those_that_the_preset_uses() {
        let names =
            |document: &ResultDocument| document.method.parameters.keys().cloned().collect::<Vec<_>>();
        let document = fork();
        assert_eq!(document.method.parameters["smoothing"], ParameterValue::Flag(false));
        assert_eq!(document.method.parameters["tip_height"], ParameterValue::Number(1.0));
        assert_eq!(names(&document), ["smoothing", "tip_height"]);
        assert_eq!(document.method.version, env!("CARGO_PKG_VERSION"));
        let paper = of(&Parameters::of(crate::centerline::Preset::Paper));
        assert_eq!(names(&paper).len(), crate::centerline::TABLE.len());
    }

    #[test]
    fn a_parameter_that_was_set_in_vain_is_a_warning() {
        for (preset, warnings) in [("default", 1), ("paper", 0)] {
            let mut parameters = Parameters::of(preset.parse().unwrap());
            parameters.set("omega", "0.8").unwrap();
            parameters.set("tip_height", "2").unwrap();
            let document = of(&parameters);
            let found: Vec<_> =
                document.warnings.iter().filter(|warning| warning.code == "unused-parameter").collect();
            assert_eq!(found.len(), warnings, "{found:?}");
            assert!(found.iter().all(|warning| warning.detail.contains("omega")), "{found:?}");
            assert_eq!(document.method.parameters.contains_key("omega"), warnings == 0);
        }
    }
}
