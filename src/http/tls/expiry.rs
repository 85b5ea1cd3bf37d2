//! When a certificate expires (RFC 5280, section 4.1): rustls does not say.

use time::{Date, Month, OffsetDateTime, Time};

/// How many days before its end a certificate is warned of.
const DAYS: i64 = 30;

/// The last second of a certificate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Expiry(pub OffsetDateTime);

/// Tags of DER (X.690, section 8) on the way to `notAfter`.
const SEQUENCE: u8 = 0x30;
const VERSION: u8 = 0xa0;
const UTC_TIME: u8 = 0x17;
const GENERALIZED_TIME: u8 = 0x18;

impl Expiry {
    /// Of a certificate in DER; `None` where it has another form.
    pub(super) fn of(certificate: &[u8]) -> Option<Self> {
        let (mut body, _) = inside(inside(certificate, SEQUENCE)?.0, SEQUENCE)?;
        if let Some((_, rest)) = inside(body, VERSION) {
            body = rest;
        }
        // The serial number, the algorithm of the signature, the issuer.
        for _ in 0..3 {
            body = element(body)?.2;
        }
        let (validity, _) = inside(body, SEQUENCE)?;
        let (tag, text, _) = element(element(validity)?.2)?;
        instant(tag, std::str::from_utf8(text).ok()?).map(Self)
    }

    /// What the operator should know within the last 30 days, and after them.
    pub fn warning(self) -> Option<String> {
        self.warning_at(OffsetDateTime::now_utc())
    }

    fn warning_at(self, now: OffsetDateTime) -> Option<String> {
        let left = self.0 - now;
        let (day, days) = (self.0.date(), left.whole_days());
        if left.is_negative() {
            Some(format!(
                "the TLS certificate has expired on {day}: clients refuse it; put a new one in its place"
            ))
        } else if days < DAYS {
            let days = if days == 1 { "1 day".to_owned() } else { format!("{days} days") };
            Some(format!("the TLS certificate expires on {day}, in {days}; put a new one in its place"))
        } else {
            None
        }
    }
}

/// The first element: its tag, what is in it, and what comes behind it.
fn element(bytes: &[u8]) -> Option<(u8, &[u8], &[u8])> {
    let (&tag, rest) = bytes.split_first()?;
    let (&first, rest) = rest.split_first()?;
    let (length, rest) = match first {
        0..=0x7f => (usize::from(first), rest),
        0x81..=0x84 => {
            let (digits, rest) = rest.split_at_checked(usize::from(first - 0x80))?;
            (digits.iter().fold(0, |length, &digit| length << 8 | usize::from(digit)), rest)
        }
        _ => return None,
    };
    let (content, rest) = rest.split_at_checked(length)?;
    Some((tag, content, rest))
}

/// What is in the first element, and what comes behind it, where it has this tag.
fn inside(bytes: &[u8], wanted: u8) -> Option<(&[u8], &[u8])> {
    let (tag, content, rest) = element(bytes)?;
    (tag == wanted).then_some((content, rest))
}

/// `YYMMDDHHMMSSZ`, of the years 1950 to 2049, or `YYYYMMDDHHMMSSZ` (RFC 5280, section 4.1.2.5).
fn instant(tag: u8, text: &str) -> Option<OffsetDateTime> {
    let number = |digits: &str| {
        digits.bytes().all(|digit| digit.is_ascii_digit()).then(|| digits.parse::<u16>().ok())?
    };
    let (year, rest) = match tag {
        UTC_TIME => {
            let (year, rest) = text.split_at_checked(2)?;
            let year = number(year)?;
            (if year < 50 { 2000 + year } else { 1900 + year }, rest)
        }
        GENERALIZED_TIME => {
            let (year, rest) = text.split_at_checked(4)?;
            (number(year)?, rest)
        }
        _ => return None,
    };
    let rest = rest.strip_suffix('Z').filter(|rest| rest.len() == 10)?;
    let pair = |at: usize| u8::try_from(number(rest.get(at..at + 2)?)?).ok();
    let date = Date::from_calendar_date(i32::from(year), Month::try_from(pair(0)?).ok()?, pair(2)?).ok()?;
    Some(date.with_time(Time::from_hms(pair(4)?, pair(6)?, pair(8)?).ok()?).assume_utc())
}

#[cfg(test)]
mod tests {
    use time::Duration;

    use super::*;

    fn certificate(not_after: OffsetDateTime) -> Vec<u8> {
        let mut parameters = rcgen::CertificateParams::new(vec!["127.0.0.1".to_owned()]).unwrap();
        parameters.not_after = not_after;
        let key = rcgen::KeyPair::generate().unwrap();
        parameters.self_signed(&key).unwrap().der().to_vec()
    }

    #[test]
    fn the_end_is_read_in_both_forms_of_time() {
        for seconds in [1_600_000_000, 1_790_000_001, 2_524_607_999, 2_524_608_000, 9_000_000_000] {
            let end = OffsetDateTime::from_unix_timestamp(seconds).unwrap();
            assert_eq!(Expiry::of(&certificate(end)), Some(Expiry(end)));
        }
    }

    #[test]
    fn what_is_no_certificate_has_no_end() {
        let whole = certificate(OffsetDateTime::now_utc());
        for length in 0..whole.len() {
            assert_eq!(Expiry::of(&whole[..length]), None);
        }
        // A byte that is damaged may give another end, or none; it brings nothing down.
        for place in 0..whole.len() {
            for bit in 0..8 {
                let mut damaged = whole.clone();
                damaged[place] ^= 1 << bit;
                let _ = Expiry::of(&damaged);
            }
        }
    }

    #[test]
    fn it_is_warned_of_within_thirty_days_and_after() {
        let end = OffsetDateTime::from_unix_timestamp(1_790_000_000).unwrap();
        let warning = |left: Duration| Expiry(end).warning_at(end - left);
        assert_eq!(warning(Duration::days(30)), None);
        assert!(warning(Duration::days(30) - Duration::SECOND).unwrap().contains("2026-09-21, in 29 days"));
        assert!(warning(Duration::ZERO).unwrap().contains("in 0 days"));
        assert!(warning(Duration::days(1)).unwrap().contains("in 1 day;"));
        assert!(warning(-Duration::SECOND).unwrap().contains("has expired on 2026-09-21"));
    }
}
