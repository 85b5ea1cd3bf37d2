//! `Accept-Encoding` (RFC 9110, section 12.5.3).

use axum::http::{HeaderMap, header};

use crate::jobs::Coding;

/// The codings that the client accepts, those that it likes most first, of equals the smaller one; the result as
/// it is comes last, and is there unless the client rules it out.
pub fn accepted(headers: &HeaderMap) -> Vec<Coding> {
    let lists = headers.get_all(header::ACCEPT_ENCODING).iter();
    let members: Vec<(String, u16)> =
        lists.flat_map(|list| list.to_str().unwrap_or_default().split(',')).filter_map(member).collect();
    let named = |name: &str| members.iter().find(|(member, _)| member == name).map(|(_, quality)| *quality);
    let others = named("*");
    let quality = |coding: Coding| named(coding.name()).or(others).unwrap_or(0);
    // Where the client says nothing of it, the result as it is costs it nothing but bytes.
    let plain = named(Coding::Identity.name()).unwrap_or(if others == Some(0) { 0 } else { 1 });
    let mut codings = vec![Coding::Zstd, Coding::Gzip];
    codings.retain(|coding| quality(*coding) > 0 && quality(*coding) >= plain);
    codings.sort_by_key(|coding| std::cmp::Reverse(quality(*coding)));
    if plain > 0 {
        codings.push(Coding::Identity);
    }
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
        assert_eq!(read("*;q=0, identity;q=0.1"), [Identity]);
    }

    #[test]
    fn the_result_as_it_is_can_be_ruled_out() {
        assert_eq!(read("identity;q=0"), []);
        assert_eq!(read("*;q=0"), []);
        assert_eq!(read("identity;q=0, br"), []);
        assert_eq!(read("gzip, *;q=0"), [Gzip]);
        assert_eq!(read("gzip;q=0.1, identity;q=0.0"), [Gzip]);
        assert_eq!(read("identity;q=0, *"), [Zstd, Gzip]);
    }
}
