//! JSON (RFC 8259): every number in the shortest form that reads back to the same `f64`.

use super::{OutputError, ResultDocument, SCHEMA};

/// Writes the document on one line, with a newline at its end.
///
/// # Errors
/// [`OutputError::NotFinite`]: JSON has no word for NaN or infinity, and `null` would hide it.
pub fn write_json(document: &ResultDocument) -> Result<Vec<u8>, OutputError> {
    check_finite(document)?;
    let mut bytes = serde_json::to_vec(document)?;
    bytes.push(b'\n');
    Ok(bytes)
}

/// Reads a document back; members that this version does not know are passed over.
///
/// # Errors
/// [`OutputError::Json`], [`OutputError::Schema`] and [`OutputError::Inconsistent`].
pub fn read_json(bytes: &[u8]) -> Result<ResultDocument, OutputError> {
    let document: ResultDocument = serde_json::from_slice(bytes)?;
    if document.schema != SCHEMA {
        return Err(OutputError::Schema { found: document.schema.chars().take(40).collect() });
    }
    document.centerline()?;
    Ok(document)
}

/// Whether bytes are such a document, of whatever version and however whole: for those who expect something else.
pub fn is_result(bytes: &[u8]) -> bool {
    #[derive(serde::Deserialize)]
    struct Probe {
        schema: String,
    }
    let family = SCHEMA.split_inclusive('/').next().unwrap_or(SCHEMA);
    serde_json::from_slice::<Probe>(bytes).is_ok_and(|probe| probe.schema.starts_with(family))
}

/// Fails when a node, a branch or the quality holds a number that is not finite.
pub(super) fn check_finite(document: &ResultDocument) -> Result<(), OutputError> {
    let broken = |place: String| Err(OutputError::NotFinite { place });
    if !document.source.diagonal.is_finite() {
        return broken("the diagonal".to_owned());
    }
    for node in &document.nodes {
        if !node.position.iter().chain([&node.radius, &node.equivalent_radius]).all(|value| value.is_finite())
        {
            return broken(format!("node {}", node.id));
        }
    }
    for branch in &document.branches {
        let numbers = branch.points.iter().flatten().chain(&branch.radii).chain(&branch.equivalent_radii);
        let numbers = numbers.chain([&branch.length]);
        if !numbers.into_iter().all(|value| value.is_finite()) {
            return broken(format!("branch {}", branch.id));
        }
    }
    if let Some(quality) = &document.quality {
        let offsets = [quality.centeredness.mean, quality.centeredness.max];
        let numbers = [quality.inside, quality.coverage].into_iter().chain(offsets.into_iter().flatten());
        if !numbers.into_iter().all(f64::is_finite) {
            return broken("the quality".to_owned());
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::document::tests::fork;
    use super::*;

    #[test]
    fn the_document_reads_back_equal_to_the_last_bit() {
        let mut document = fork();
        document.branches[0].points[1] = [0.1 + 0.2, 1.0 / 3.0, -5e-324];
        document.branches[0].radii[0] = 9.500000000000002;
        let bytes = write_json(&document).unwrap();
        assert_eq!(read_json(&bytes).unwrap(), document);
        assert_eq!(write_json(&read_json(&bytes).unwrap()).unwrap(), bytes);
    }

    #[test]
    fn the_members_stand_in_the_order_of_the_schema() {
        let text = String::from_utf8(write_json(&fork()).unwrap()).unwrap();
        let members = ["schema", "units", "source", "method", "nodes", "branches", "warnings"];
        let places: Vec<_> = members.iter().map(|name| text.find(&format!("\"{name}\":")).unwrap()).collect();
        assert!(places.is_sorted(), "{places:?}");
        assert!(text.ends_with("}\n"));
    }

    #[test]
    fn numbers_that_json_cannot_hold_are_refused() {
        let mut document = fork();
        document.branches[2].radii[1] = f64::NAN;
        let error = write_json(&document).unwrap_err();
        assert!(error.to_string().contains("branch 2"), "{error}");
    }

    #[test]
    fn documents_that_lie_are_refused() {
        let other = String::from_utf8(write_json(&fork()).unwrap()).unwrap();
        let other = other.replace(SCHEMA, "rosaline.centerline/9");
        assert!(matches!(read_json(other.as_bytes()), Err(OutputError::Schema { .. })));
        let mut document = fork();
        document.branches[1].to = 17;
        let bytes = serde_json::to_vec(&document).unwrap();
        let error = read_json(&bytes).unwrap_err();
        assert_eq!(
            error.to_string(),
            "the document contradicts itself: branch 1 names node 17 and there are 4 nodes"
        );
        let mut document = fork();
        document.branches[1].radii.pop();
        let bytes = serde_json::to_vec(&document).unwrap();
        assert!(matches!(read_json(&bytes), Err(OutputError::Inconsistent { .. })));
        assert!(matches!(read_json(b"{}"), Err(OutputError::Json(_))));
    }
}
