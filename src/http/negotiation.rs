//! Content negotiation by `Accept` (RFC 9110, section 12.5.1).

use axum::http::{HeaderMap, header};

/// The place in `offers` that the client likes most; of equals the first. `None`: it accepts none.
///
/// A client that sends no `Accept` takes anything. What cannot be parsed is passed over.
pub fn preferred(headers: &HeaderMap, offers: &[&str]) -> Option<usize> {
    let mut ranges = Vec::new();
    for value in headers.get_all(header::ACCEPT) {
        ranges.extend(value.to_str().unwrap_or_default().split(',').filter_map(MediaRange::parse));
    }
    if ranges.is_empty() {
        return if offers.is_empty() { None } else { Some(0) };
    }
    let mut best: Option<(usize, u16)> = None;
    for (place, offer) in offers.iter().enumerate() {
        let quality = quality(offer, &ranges);
        if quality > best.map_or(0, |(_, quality)| quality) {
            best = Some((place, quality));
        }
    }
    best.map(|(place, _)| place)
}

/// The quality that the most specific range gives to `offer`, in thousandths.
fn quality(offer: &str, ranges: &[MediaRange<'_>]) -> u16 {
    let matching = ranges.iter().filter(|range| range.specificity(offer) > 0);
    matching.max_by_key(|range| range.specificity(offer)).map_or(0, |range| range.quality)
}

/// One element of `Accept`.
#[derive(Debug, PartialEq)]
struct MediaRange<'a> {
    kind: &'a str,
    subkind: &'a str,
    /// In thousandths: `q` has at most three digits after the point.
    quality: u16,
}

impl<'a> MediaRange<'a> {
    fn parse(text: &'a str) -> Option<Self> {
        let mut parts = text.split(';').map(str::trim);
        let (kind, subkind) = parts.next()?.split_once('/')?;
        let mut quality = 1000;
        for part in parts {
            let Some((name, value)) = part.split_once('=') else { continue };
            if name.trim().eq_ignore_ascii_case("q") {
                let value: f64 = value.trim().parse().ok().filter(|value| (0.0..=1.0).contains(value))?;
                quality = (value * 1000.0).round() as u16;
            }
        }
        if kind.is_empty() || subkind.is_empty() { None } else { Some(Self { kind, subkind, quality }) }
    }

    /// 3 names the offer itself, 2 its type, 1 anything, 0 something else.
    fn specificity(&self, offer: &str) -> u8 {
        let (kind, subkind) = offer.split_once('/').unwrap_or((offer, ""));
        match (self.kind, self.subkind) {
            ("*", "*") => 1,
            (_, "*") if self.kind.eq_ignore_ascii_case(kind) => 2,
            _ if self.kind.eq_ignore_ascii_case(kind) && self.subkind.eq_ignore_ascii_case(subkind) => 3,
            _ => 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OFFERS: [&str; 3] = ["application/json", "model/gltf-binary", "model/gltf+json"];

    fn choose(accept: &str) -> Option<usize> {
        let mut headers = HeaderMap::new();
        headers.insert(header::ACCEPT, accept.parse().unwrap());
        preferred(&headers, &OFFERS)
    }

    #[test]
    fn the_best_quality_wins_and_of_equals_the_first_offer() {
        assert_eq!(preferred(&HeaderMap::new(), &OFFERS), Some(0));
        assert_eq!(choose("*/*"), Some(0));
        assert_eq!(choose("model/gltf-binary"), Some(1));
        assert_eq!(choose("model/*"), Some(1));
        assert_eq!(choose("application/json;q=0.5, model/gltf+json;q=0.9"), Some(2));
        assert_eq!(choose("MODEL/GLTF+JSON"), Some(2));
        assert_eq!(choose("text/html, */*;q=0.1"), Some(0));
    }

    #[test]
    fn the_most_specific_range_decides_also_against_an_offer() {
        assert_eq!(choose("*/*, application/json;q=0"), Some(1));
        assert_eq!(choose("model/*;q=0.9, model/gltf-binary;q=0.2, */*;q=0.1"), Some(2));
    }

    #[test]
    fn none_fits() {
        assert_eq!(choose("text/html"), None);
        assert_eq!(choose("application/json;q=0"), None);
        assert_eq!(choose("image/*;q=1.0"), None);
    }

    #[test]
    fn what_is_not_a_media_range_is_passed_over() {
        assert_eq!(choose("nonsense, model/gltf-binary;q=0.3"), Some(1));
        assert_eq!(choose("model/gltf-binary;q=7, application/json;q=0.1"), Some(0));
        assert_eq!(choose("nonsense"), Some(0));
    }
}
