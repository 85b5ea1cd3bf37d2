//! Numbers one after another, written in ASCII or in binary.

use super::scalar::{ByteOrder, Scalar};
use super::text::Tokens;
use super::{Format, ReadError};

/// A place in a file, and how numbers stand there.
#[derive(Clone)]
pub(super) struct Values<'a> {
    pub(super) tokens: Tokens<'a>,
    /// `None` for text.
    order: Option<ByteOrder>,
}

impl<'a> Values<'a> {
    pub(super) fn text(tokens: Tokens<'a>) -> Self {
        Values { tokens, order: None }
    }

    pub(super) fn binary(tokens: Tokens<'a>, order: ByteOrder) -> Self {
        Values { tokens, order: Some(order) }
    }

    pub(super) fn is_binary(&self) -> bool {
        self.order.is_some()
    }

    #[inline]
    pub(super) fn real(&mut self, scalar: Scalar) -> Result<f64, ReadError> {
        match self.order {
            Some(order) => Ok(scalar.real(order, self.tokens.take(scalar.size())?)),
            None => self.tokens.number(),
        }
    }

    #[inline]
    pub(super) fn integer(&mut self, scalar: Scalar) -> Result<i64, ReadError> {
        match self.order {
            Some(order) => Ok(scalar.integer(order, self.tokens.take(scalar.size())?)),
            None => self.tokens.integer(),
        }
    }

    /// A number of things, which is not negative.
    pub(super) fn count(&mut self, scalar: Scalar) -> Result<usize, ReadError> {
        let count = self.integer(scalar)?;
        usize::try_from(count)
            .map_err(|_| self.tokens.malformed(&format!("a count is {count}, which is negative; it ends")))
    }

    /// Puts the next `count` integers into `list`.
    pub(super) fn integers(
        &mut self,
        scalar: Scalar,
        count: usize,
        list: &mut Vec<i64>,
    ) -> Result<(), ReadError> {
        list.clear();
        match self.order {
            Some(order) => {
                let bytes = self.tokens.take(scalar.size().saturating_mul(count))?;
                list.extend(bytes.chunks_exact(scalar.size()).map(|bytes| scalar.integer(order, bytes)));
            }
            None => {
                for _ in 0..count {
                    list.push(self.tokens.integer()?);
                }
            }
        }
        Ok(())
    }

    pub(super) fn skip(&mut self, scalar: Scalar, count: usize) -> Result<(), ReadError> {
        match self.order {
            Some(_) => self.tokens.take(scalar.size().saturating_mul(count)).map(drop),
            None => (0..count).try_for_each(|_| self.tokens.next().map(drop)),
        }
    }

    /// How many numbers the rest of the file can hold; of text a digit and a space each.
    pub(super) fn most(&self, scalar: Scalar) -> usize {
        match self.order {
            Some(_) => self.tokens.left() / scalar.size(),
            // The last one may lack its space.
            None => self.tokens.left().div_ceil(2),
        }
    }

    /// Fails when the rest of the file cannot hold the `declared` things, of which `most` fit.
    pub(super) fn check_count(&self, format: Format, declared: usize, most: usize) -> Result<(), ReadError> {
        if declared > most {
            let detail = format!("it declares {declared} elements where {most} at most fit");
            return Err(ReadError::Truncated { format, detail });
        }
        Ok(())
    }
}
