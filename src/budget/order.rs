//! The order of draws as a lever on time: fewer changes of state, fewer pixels shaded in vain.

/// The state that a draw needs; equal numbers are the same state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct DrawState {
    /// Transformation.
    pub matrix: u32,
    /// Texture, usually the dearest to change after the shader.
    pub texture: u32,
    /// Material.
    pub material: u32,
    /// Blending.
    pub alpha: u32,
}

/// Changes of state in a sequence of draws; the first draw sets all.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StateChanges {
    /// Of the transformation.
    pub matrix: u32,
    /// Of the texture.
    pub texture: u32,
    /// Of the material.
    pub material: u32,
    /// Of blending.
    pub alpha: u32,
}

impl StateChanges {
    /// All of them.
    pub fn total(&self) -> u32 {
        self.matrix + self.texture + self.material + self.alpha
    }
}

/// How draws are sorted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StateOrder {
    /// As they come.
    Unsorted,
    /// By transformation, then texture, then the rest.
    MatrixFirst,
    /// By texture, then material and blending, then transformation: the fewest texture changes.
    TextureFirst,
}

impl StateOrder {
    /// All orders.
    pub const ALL: [StateOrder; 3] =
        [StateOrder::Unsorted, StateOrder::MatrixFirst, StateOrder::TextureFirst];

    /// The order in words.
    pub fn name(self) -> &'static str {
        match self {
            StateOrder::Unsorted => "no sort",
            StateOrder::MatrixFirst => "matrix, texture",
            StateOrder::TextureFirst => "texture, matrix",
        }
    }

    /// Sorts draws by the state that `state` gives; equal ones keep their order.
    pub fn sort<T>(self, draws: &mut [T], state: impl Fn(&T) -> DrawState) {
        match self {
            StateOrder::Unsorted => {}
            StateOrder::MatrixFirst => draws.sort_by_key(|draw| {
                let DrawState { matrix, texture, material, alpha } = state(draw);
                [matrix, texture, material, alpha]
            }),
            StateOrder::TextureFirst => draws.sort_by_key(|draw| {
                let DrawState { matrix, texture, material, alpha } = state(draw);
                [texture, material, alpha, matrix]
            }),
        }
    }
}

/// Counts the changes of state from draw to draw.
pub fn state_changes(draws: impl IntoIterator<Item = DrawState>) -> StateChanges {
    let mut changes = StateChanges::default();
    let mut last: Option<DrawState> = None;
    for state in draws {
        let differs = |of: fn(&DrawState) -> u32| {
            u32::from(last.as_ref().is_none_or(|last| of(last) != of(&state)))
        };
        changes.matrix += differs(|s| s.matrix);
        changes.texture += differs(|s| s.texture);
        changes.material += differs(|s| s.material);
        changes.alpha += differs(|s| s.alpha);
        last = Some(state);
    }
    changes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::Random;

    struct House {
        state: DrawState,
        distance: f64,
        /// First and last column and row on screen.
        area: [u32; 4],
    }

    /// A street of houses with few textures, many transformations, seen from one end.
    fn city(seed: u64) -> Vec<House> {
        let house = |index| {
            let mut random = Random::new(seed, index);
            let distance = random.between(5.0, 300.0);
            let size = (2000.0 / distance) as u32;
            let (x, y) = (random.below(128) as u32, 32 + random.below(32) as u32);
            House {
                state: DrawState {
                    matrix: random.below(200) as u32,
                    texture: random.below(20) as u32,
                    material: random.below(6) as u32,
                    alpha: random.below(2) as u32,
                },
                distance,
                area: [x, y, (x + size).min(127), (y + size).min(63)],
            }
        };
        (0..400).map(house).collect()
    }

    /// Pixels that pass the depth test when they come.
    fn shaded(houses: &[House]) -> u64 {
        let mut depth = vec![f64::INFINITY; 128 * 64];
        let mut count = 0;
        for house in houses {
            let [left, top, right, bottom] = house.area;
            for at in (top..=bottom).flat_map(|y| (left..=right).map(move |x| y * 128 + x)) {
                if house.distance < depth[at as usize] {
                    depth[at as usize] = house.distance;
                    count += 1;
                }
            }
        }
        count
    }

    #[test]
    fn sorting_by_texture_gives_the_fewest_texture_changes() {
        for seed in 0..20 {
            let mut houses = city(seed);
            let mut different: Vec<u32> = houses.iter().map(|h| h.state.texture).collect();
            different.sort_unstable();
            different.dedup();
            let [unsorted, by_matrix, by_texture] = StateOrder::ALL.map(|order| {
                order.sort(&mut houses, |house| house.state);
                state_changes(houses.iter().map(|house| house.state))
            });
            assert_eq!(by_texture.texture, different.len() as u32, "no order has fewer");
            assert!(by_texture.texture < by_matrix.texture.min(unsorted.texture) / 4);
            assert!(by_matrix.matrix < by_texture.matrix.min(unsorted.matrix));
            assert!(by_texture.total() < unsorted.total());
        }
    }

    #[test]
    fn front_to_back_shades_fewer_pixels_than_back_to_front() {
        for seed in 0..20 {
            let mut houses = city(seed);
            let unsorted = shaded(&houses);
            houses.sort_by(|a, b| a.distance.total_cmp(&b.distance));
            let front_to_back = shaded(&houses);
            houses.reverse();
            let back_to_front = shaded(&houses);
            assert!(front_to_back < unsorted && unsorted < back_to_front);
        }
    }

    #[test]
    fn no_draw_changes_nothing() {
        assert_eq!(state_changes([]).total(), 0);
        assert_eq!(state_changes([DrawState::default(); 3]).total(), 4);
    }
}
