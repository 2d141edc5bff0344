//! How a part of a picture and its bias are printed.

use crate::stats::{Part, Place, Quantity};

/// A part's bias with its interval, in percent: `+0.12 [-0.03, +0.27]`.
pub(super) fn percent(part: &Part, confidence: f64) -> String {
    let (low, high) = part.relative_interval(confidence);
    format!("{:+.2} [{:+.2}, {:+.2}]", 100.0 * part.relative(), 100.0 * low, 100.0 * high)
}

/// Where a part lies, without what goes without saying: `blue`, `(16, 0)`, `blue of (16, 0)`; empty
/// for the image's luminance.
pub(super) fn place(part: &Part) -> String {
    let quantity = match part.quantity {
        Quantity::Luminance => "",
        Quantity::Red => "red",
        Quantity::Green => "green",
        Quantity::Blue => "blue",
    };
    match part.place {
        Place::Image => quantity.to_string(),
        Place::Tile { x, y } if quantity.is_empty() => format!("({x}, {y})"),
        Place::Tile { x, y } => format!("{quantity} of ({x}, {y})"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stats::{Moments, t_test};

    fn part(place: Place, quantity: Quantity) -> Part {
        let sample: Moments = [0.9, 1.0, 1.1, 1.2].into_iter().collect();
        Part { place, quantity, test: t_test(&sample, 1.0), scale: 1.0, delta: 0.01 }
    }

    #[test]
    fn what_goes_without_saying_is_not_said() {
        let tile = Place::Tile { x: 16, y: 0 };
        for (at, quantity, text) in [
            (Place::Image, Quantity::Luminance, ""),
            (Place::Image, Quantity::Blue, "blue"),
            (tile, Quantity::Luminance, "(16, 0)"),
            (tile, Quantity::Red, "red of (16, 0)"),
        ] {
            assert_eq!(place(&part(at, quantity)), text);
        }
        let text = percent(&part(tile, Quantity::Red), 0.95);
        assert!(text.starts_with("+5.00 [-15.54, +25.54]"), "{text}");
    }
}
