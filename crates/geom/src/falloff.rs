//! How the occlusion of ambient light fades with the distance of the occluder.

/// Weight of an occluder by its distance, from 1 at the receiver down to 0 at the radius and beyond.
///
/// `x` is distance divided by radius. All forms are 0 for `x >= 1`. Read as a probability, `weight(x)` is the share of
/// rays that are longer than `x`: rays cut to random lengths with that distribution give the same expected occlusion as
/// weighting the nearest hit ([`Self::length`]).
///
/// # Source
/// The falloff function of Laine and Karras 2010, equation 3; the forms are ours.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub enum Falloff {
    /// 1 everywhere inside the radius.
    #[default]
    Constant,
    /// `1 - x`.
    Linear,
    /// `(1 - x)^2`.
    Quadratic,
    /// `exp(-5 x)`, cut off at the radius.
    Exponential,
    /// Weights at evenly spaced `x` from 0 to 1, linear between; see [`Self::table`].
    Table(Vec<f32>),
}

/// Why a falloff can't be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FalloffError {
    /// No form has that name.
    #[error("unknown falloff '{0}': expected constant, linear, quadratic, exponential or a table of weights")]
    Name(String),
    /// A table needs at least two entries.
    #[error("a falloff table needs at least 2 weights, not {0}")]
    Short(usize),
    /// A weight is NaN or outside `[0, 1]`.
    #[error("falloff weight {index} is {weight}, which is not between 0 and 1")]
    Weight {
        /// Index of the weight, from 0.
        index: usize,
        /// The weight.
        weight: f32,
    },
    /// Weights must not grow with distance.
    #[error("falloff weight {index} is larger than the one before it")]
    Grows {
        /// Index of the weight, from 0.
        index: usize,
    },
}

impl Falloff {
    /// A table of weights at evenly spaced distances from 0 to the radius, at least two, in `[0, 1]`, not increasing.
    ///
    /// # Errors
    /// [`FalloffError::Short`], [`FalloffError::Weight`], [`FalloffError::Grows`].
    pub fn table(weights: Vec<f32>) -> Result<Self, FalloffError> {
        if weights.len() < 2 {
            return Err(FalloffError::Short(weights.len()));
        }
        for (index, &weight) in weights.iter().enumerate() {
            if !(0.0..=1.0).contains(&weight) {
                return Err(FalloffError::Weight { index, weight });
            }
            if index > 0 && weight > weights[index - 1] {
                return Err(FalloffError::Grows { index });
            }
        }
        Ok(Self::Table(weights))
    }

    /// Weight at `x` = distance / radius; NaN and negative `x` count as 0.
    pub fn weight(&self, x: f32) -> f32 {
        if x >= 1.0 {
            return 0.0;
        }
        let x = x.max(0.0);
        match self {
            Self::Constant => 1.0,
            Self::Linear => 1.0 - x,
            Self::Quadratic => (1.0 - x) * (1.0 - x),
            Self::Exponential => (-5.0 * x).exp(),
            Self::Table(weights) => {
                let last = weights.len() - 1;
                let at = x * last as f32;
                let i = (at as usize).min(last - 1);
                weights[i] + (weights[i + 1] - weights[i]) * (at - i as f32)
            }
        }
    }

    /// The length, in radii, of the ray that belongs to the random number `u` in `[0, 1)`: the largest `x` with
    /// `weight(x) > u`, found by bisection to within a unit in the last place.
    pub fn length(&self, u: f32) -> f32 {
        let (mut inside, mut outside) = (0f32, 1f32);
        if self.weight(1f32.next_down()) > u {
            return 1.0;
        }
        for _ in 0..30 {
            let middle = 0.5 * (inside + outside);
            if self.weight(middle) > u {
                inside = middle;
            } else {
                outside = middle;
            }
        }
        outside
    }
}

impl std::str::FromStr for Falloff {
    type Err = FalloffError;

    /// One of the names, or weights separated by commas.
    fn from_str(s: &str) -> Result<Self, FalloffError> {
        match s {
            "constant" => Ok(Self::Constant),
            "linear" => Ok(Self::Linear),
            "quadratic" => Ok(Self::Quadratic),
            "exponential" => Ok(Self::Exponential),
            list if list.contains(',') => list
                .split(',')
                .map(|w| w.trim().parse::<f32>().map_err(|_| FalloffError::Name(s.into())))
                .collect::<Result<_, _>>()
                .and_then(Self::table),
            _ => Err(FalloffError::Name(s.into())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn lengths_invert_weights(u in 0f32..1.0, which in 0usize..5) {
            let table = Falloff::table(vec![1.0, 0.9, 0.2, 0.2, 0.0]).unwrap();
            let falloff =
                [Falloff::Constant, Falloff::Linear, Falloff::Quadratic, Falloff::Exponential, table][which].clone();
            let x = falloff.length(u);
            prop_assert!((0.0..=1.0).contains(&x));
            prop_assert!(falloff.weight((x - 1e-4).max(0.0)) >= u - 1e-6);
            prop_assert!(falloff.weight(x + 1e-4) <= u + 1e-6);
        }
    }

    #[test]
    fn no_weight_is_left_at_the_radius() {
        let step = Falloff::table(vec![1.0, 0.5]).unwrap();
        let all = [Falloff::Constant, Falloff::Linear, Falloff::Quadratic, Falloff::Exponential, step];
        for falloff in all {
            for beyond in [1.0, 1f32.next_up(), 2.0, f32::INFINITY] {
                assert_eq!(falloff.weight(beyond), 0.0, "{falloff:?} at {beyond}");
            }
            assert!(falloff.weight(1f32.next_down()) > 0.0, "{falloff:?}");
            for start in [0.0, -1.0, f32::NAN] {
                assert_eq!(falloff.weight(start), 1.0, "{falloff:?} at {start}");
            }
        }
    }

    #[test]
    fn names_and_tables_are_checked() {
        assert_eq!("linear".parse(), Ok(Falloff::Linear));
        assert_eq!("1, 0.5,0".parse(), Ok(Falloff::Table(vec![1.0, 0.5, 0.0])));
        assert_eq!("cubic".parse::<Falloff>(), Err(FalloffError::Name("cubic".into())));
        assert_eq!(Falloff::table(vec![1.0]), Err(FalloffError::Short(1)));
        assert_eq!(Falloff::table(vec![0.5, 0.6]), Err(FalloffError::Grows { index: 1 }));
        assert!(matches!("1,nan".parse::<Falloff>(), Err(FalloffError::Weight { index: 1, .. })));
        assert_eq!(Falloff::Constant.length(0.999), 1.0);
    }
}
