//! `Accept-Encoding` (RFC 9110, section 12.5.3).

use axum::http::{HeaderMap, header};

use crate::jobs::Coding;

/// The codings that the client accepts, those that it likes most first, of equals the smaller one; the result as
/// it is comes last and is always there.
pub fn accepted(headers: &HeaderMap) -> Vec<Coding> {
    let lists = headers.get_all(header::ACCEPT_ENCODING).iter();
    let members: Vec<(String, u16)> =
        lists.flat_map(|list| list.to_str().unwrap_or_default().split(',')).filter_map(member).collect();
    let quality = |coding: Coding| {
        let named = members.iter().find(|(name, _)| name == coding.name());
        named.or_else(|| members.iter().find(|(name, _)| name == "*")).map_or(0, |(_, quality)| *quality)
    };
    // Where the client says nothing of it, the result as it is costs it nothing but bytes.
    let plain =
        members.iter().find(|(name, _)| name == Coding::Identity.name()).map_or(1, |(_, quality)| *quality);
    let mut codings = vec![Coding::Zstd, Coding::Gzip];
    codings.retain(|coding| quality(*coding) > 0 && quality(*coding) >= plain);
    codings.sort_by_key(|coding| std::cmp::Reverse(quality(*coding)));
    codings.push(Coding::Identity);
    codings
}

/// A coding's name and its quality in thousandths.
fn member(text: &str) -> Option<(String, u16)> {
    let mut parts = text.split(';').map(str::trim);
    let name = parts.next().filter(|name| !name.is_empty())?.to_ascii_lowercase();
    let name = if name == "x-gzip" { Coding::Gzip.name().to_owned() } else { name };
    let mut quality = 1000;
    for part in parts {
        if let Some(value) = part.strip_prefix("q=").or_else(|| part.strip_prefix("Q=")) {
            let value: f64 = value.trim().parse().ok().filter(|value| (0.0..=1.0).contains(value))?;
            quality = (value * 1000.0).round() as u16;
        }
    }
    Some((name, quality))
}

#[cfg(test)]
mod tests {
    use super::*;
    use Coding::{Gzip, Identity, Zstd};

    fn read(value: &str) -> Vec<Coding> {
        accepted(&HeaderMap::from_iter([(header::ACCEPT_ENCODING, value.parse().unwrap())]))
    }

    #[test]
    fn codings_are_ranked_by_quality() {
        assert_eq!(accepted(&HeaderMap::new()), [Identity]);
        assert_eq!(read("gzip"), [Gzip, Identity]);
        assert_eq!(read("gzip, deflate, br, zstd"), [Zstd, Gzip, Identity]);
        assert_eq!(read("zstd;q=0.2, X-GZIP;q=0.9"), [Gzip, Zstd, Identity]);
        assert_eq!(read("*"), [Zstd, Gzip, Identity]);
        assert_eq!(read("*, zstd;q=0"), [Gzip, Identity]);
        assert_eq!(read("identity, gzip;q=0.5"), [Identity]);
        assert_eq!(read("gzip;q=0, br"), [Identity]);
        assert_eq!(read("gzip;q=7, "), [Identity]);
    }
}
