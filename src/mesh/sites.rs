//! Where something was found, for warnings and errors.

use std::fmt;

/// How many places something was found at, and the first of them.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Sites {
    pub count: usize,
    /// Numbers of vertices or triangles in the input, from 0; those past `count` say nothing.
    pub first: [u32; Sites::KEPT],
}

impl Sites {
    /// How many places are kept.
    pub const KEPT: usize = 24;
    /// How many places a message names.
    pub const NAMED: usize = 5;

    pub(super) fn add(&mut self, site: u32) {
        if let Some(slot) = self.first.get_mut(self.count) {
            *slot = site;
        }
        self.count += 1;
    }

    /// The same places by other numbers.
    pub(super) fn renamed(mut self, names: &[u32]) -> Self {
        let named = self.count.min(Self::KEPT);
        self.first[..named].iter_mut().for_each(|site| *site = names[*site as usize]);
        self
    }

    /// The places that are kept.
    pub fn indices(&self) -> &[u32] {
        &self.first[..self.count.min(Self::KEPT)]
    }

    /// The places that are named, for messages: `3, 17, ...`.
    pub fn list(&self) -> String {
        let named: Vec<String> =
            self.first.iter().take(self.count.min(Self::NAMED)).map(u32::to_string).collect();
        named.join(", ") + if self.count > Self::NAMED { ", ..." } else { "" }
    }
}

impl FromIterator<u32> for Sites {
    fn from_iter<T: IntoIterator<Item = u32>>(sites: T) -> Self {
        let mut all = Self::default();
        sites.into_iter().for_each(|site| all.add(site));
        all
    }
}

impl fmt::Display for Sites {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.count)
    }
}
