//! The coefficients of DOP853: twelve stages of order 8, embedded methods of orders 5 and 3, and a continuous
//! extension of order 7. The extension uses four more stages, of which the first is the right-hand side at
//! the end of the step.
//!
//! E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, second edition, sections
//! II.5 and II.6. The tests below check the numbers against the order conditions.

use crate::tableau::{Dense, Estimate, Explicit, StageWeights, Tableau};

const STAGES: usize = 16;

#[derive(Debug)]
pub(crate) struct Dop853;

impl Explicit<STAGES> for Dop853 {
    const TABLEAU: Tableau<STAGES> = Tableau {
        order: 8,
        end: 12,
        c: C,
        a: A,
        error: Estimate::Two(ERROR_5, ERROR_3),
        dense: Dense::Terms(DENSE),
    };
}

#[rustfmt::skip]
const C: [f64; STAGES] = [0.0, 0.052_600_151_958_767_73, 0.078_900_227_938_151_6, 0.118_350_341_907_227_4, 0.281_649_658_092_772_6, 0.333_333_333_333_333_3, 0.25, 0.307_692_307_692_307_7, 0.651_282_051_282_051_3, 0.6, 0.857_142_857_142_857_1, 1.0, 1.0, 0.1, 0.2, 0.777_777_777_777_777_8];

/// Weights of the stages. Row 12 is the solution of order 8; rows 13 to 15 belong to the continuous
/// extension.
#[rustfmt::skip]
const A: [StageWeights; STAGES] = [
    &[],
    &[(0, 0.052_600_151_958_767_73)],
    &[(0, 0.019_725_056_984_537_9), (1, 0.059_175_170_953_613_7)],
    &[(0, 0.029_587_585_476_806_85), (2, 0.088_762_756_430_420_54)],
    &[(0, 0.241_365_134_159_266_7), (2, -0.884_549_479_328_286_1), (3, 0.924_834_003_261_792)],
    &[(0, 0.037_037_037_037_037_035), (3, 0.170_828_608_729_473_86), (4, 0.125_467_687_566_822_42)],
    &[(0, 0.037_109_375), (3, 0.170_252_211_019_544_05), (4, 0.060_216_538_980_455_96), (5, -0.017_578_125)],
    &[(0, 0.037_092_000_118_504_79), (3, 0.170_383_925_712_239_98), (4, 0.107_262_030_446_373_28), (5, -0.015_319_437_748_624_402), (6, 0.008_273_789_163_814_023)],
    &[(0, 0.624_110_958_716_075_7), (3, -3.360_892_629_446_941_4), (4, -0.868_219_346_841_726), (5, 27.592_099_699_446_71), (6, 20.154_067_550_477_894), (7, -43.489_884_181_069_96)],
    &[(0, 0.477_662_536_438_264_34), (3, -2.488_114_619_971_667_7), (4, -0.590_290_826_836_843), (5, 21.230_051_448_181_193), (6, 15.279_233_632_882_423), (7, -33.288_210_968_984_86), (8, -0.020_331_201_708_508_627)],
    &[(0, -0.937_142_430_085_987_3), (3, 5.186_372_428_844_064), (4, 1.091_437_348_996_729_5), (5, -8.149_787_010_746_927), (6, -18.520_065_659_996_96), (7, 22.739_487_099_350_505), (8, 2.493_605_552_679_652_3), (9, -3.046_764_471_898_219_6)],
    &[(0, 2.273_310_147_516_538), (3, -10.534_495_466_737_25), (4, -2.000_872_058_224_862_5), (5, -17.958_931_863_118_8), (6, 27.948_884_529_419_96), (7, -2.858_998_277_135_023_5), (8, -8.872_856_933_530_63), (9, 12.360_567_175_794_303), (10, 0.643_392_746_015_763_6)],
    &[(0, 0.054_293_734_116_568_765), (5, 4.450_312_892_752_409), (6, 1.891_517_899_314_500_3), (7, -5.801_203_960_010_585), (8, 0.311_164_366_957_819_9), (9, -0.152_160_949_662_516_1), (10, 0.201_365_400_804_030_34), (11, 0.044_710_615_727_772_59)],
    &[(0, 0.056_167_502_283_047_954), (6, 0.253_500_210_216_624_83), (7, -0.246_239_037_470_802_5), (8, -0.124_191_423_263_816_37), (9, 0.153_291_798_278_765_68), (10, 0.008_201_052_295_634_69), (11, 0.007_567_897_660_545_699), (12, -0.008_298)],
    &[(0, 0.031_834_648_163_502_14), (5, 0.028_300_909_672_366_776), (6, 0.053_541_988_307_438_566), (7, -0.054_923_748_571_390_99), (10, -0.000_108_347_328_697_249_32), (11, 0.000_382_571_090_835_658_4), (12, -0.000_340_465_008_687_404_56), (13, 0.141_312_443_674_632_5)],
    &[(0, -0.428_896_301_583_791_94), (5, -4.697_621_415_361_164), (6, 7.683_421_196_062_599), (7, 4.068_989_818_397_11), (8, 0.356_727_187_455_281_1), (12, -0.001_399_024_165_159_014_5), (13, 2.947_514_789_152_772_4), (14, -9.150_958_472_179_87)],
];

/// The solution minus the embedded solution of order 5.
#[rustfmt::skip]
const ERROR_5: StageWeights =
    &[(0, 0.013_120_044_994_194_88), (5, -1.225_156_446_376_204_4), (6, -0.495_758_949_657_250_2), (7, 1.664_377_182_454_986_4), (8, -0.350_328_848_749_973_66), (9, 0.334_179_118_713_017_5), (10, 0.081_923_206_485_115_71), (11, -0.022_355_307_863_886_294)];

/// The solution minus the embedded solution of order 3.
#[rustfmt::skip]
const ERROR_3: StageWeights =
    &[(0, -0.189_800_754_072_407_62), (5, 4.450_312_892_752_409), (6, 1.891_517_899_314_500_3), (7, -5.801_203_960_010_585), (8, -0.422_682_321_323_791_9), (9, -0.152_160_949_662_516_1), (10, 0.201_365_400_804_030_34), (11, 0.022_651_792_198_360_82)];

/// The four highest terms of the continuous extension of order 7.
#[rustfmt::skip]
const DENSE: [StageWeights; 4] = [
    &[(0, -8.428_938_276_109_013), (5, 0.566_714_953_519_377_7), (6, -3.068_949_945_949_891_7), (7, 2.384_667_656_512_07), (8, 2.117_034_582_445_028), (9, -0.871_391_583_777_973), (10, 2.240_437_430_260_788_3), (11, 0.631_578_778_769_468_8), (12, -0.088_990_336_451_333_31), (13, 18.148_505_520_854_727), (14, -9.194_632_392_478_356), (15, -4.436_036_387_594_894)],
    &[(0, 10.427_508_642_579_134), (5, 242.283_491_775_258_17), (6, 165.200_451_717_270_28), (7, -374.546_754_722_690_2), (8, -22.113_666_853_125_306), (9, 7.733_432_668_472_264), (10, -30.674_084_731_089_398), (11, -9.332_130_526_430_229), (12, 15.697_238_121_770_845), (13, -31.139_403_219_565_178), (14, -9.352_924_358_844_48), (15, 35.816_841_486_394_08)],
    &[(0, 19.985_053_242_002_433), (5, -387.037_308_749_351_8), (6, -189.178_138_195_167_58), (7, 527.808_159_205_423_6), (8, -11.573_902_539_959_63), (9, 6.881_232_694_696_3), (10, -1.000_605_096_691_083_8), (11, 0.777_713_779_805_344_3), (12, -2.778_205_752_353_508), (13, -60.196_695_231_264_12), (14, 84.320_405_506_677_16), (15, 11.992_291_136_182_79)],
    &[(0, -25.693_933_462_703_75), (5, -154.189_748_690_236_43), (6, -231.529_379_176_045_5), (7, 357.639_117_910_614_1), (8, 93.405_324_183_624_32), (9, -37.458_323_136_451_63), (10, 104.099_649_508_962_3), (11, 29.840_293_426_660_5), (12, -43.533_456_590_011_14), (13, 96.324_553_959_188_28), (14, -39.177_261_675_615_44), (15, -149.726_836_257_985_64)],
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::explicit_rk::continuous::{dense_terms, factors};
    use crate::stages::Stages;

    /// A rooted tree: its order, its density, and the subtrees of its root.
    struct Tree {
        order: usize,
        density: f64,
        children: Vec<usize>,
    }

    /// All rooted trees up to an order, children before parents.
    fn trees(most: usize) -> Vec<Tree> {
        fn grow(
            found: &[Tree],
            rest: usize,
            least: usize,
            chosen: &mut Vec<usize>,
            all: &mut Vec<Vec<usize>>,
        ) {
            if rest == 0 {
                all.push(chosen.clone());
            }
            for i in least..found.len() {
                if found[i].order <= rest {
                    chosen.push(i);
                    grow(found, rest - found[i].order, i, chosen, all);
                    chosen.pop();
                }
            }
        }
        let mut found: Vec<Tree> = Vec::new();
        for order in 1..=most {
            let mut all = Vec::new();
            grow(&found, order - 1, 0, &mut Vec::new(), &mut all);
            let new: Vec<Tree> = all
                .into_iter()
                .map(|children| {
                    let density = order as f64 * children.iter().map(|&c| found[c].density).product::<f64>();
                    Tree { order, density, children }
                })
                .collect();
            found.extend(new);
        }
        found
    }

    /// Weights of the stages in the continuous extension at `theta`.
    fn dense_weights(theta: f64) -> [f64; STAGES] {
        std::array::from_fn(|stage| {
            let (mut k, mut dense) = (Stages::default(), Stages::default());
            k.begin(1);
            dense.begin(1);
            k.get_mut(stage)[0] = 1.0;
            dense_terms(&Dop853::TABLEAU, &DENSE, &k, 1.0, &mut dense);
            factors(theta).iter().enumerate().map(|(term, f)| dense.get(term)[0] * f).sum()
        })
    }

    fn dot(weights: &[(usize, f64)], v: &[f64; STAGES]) -> f64 {
        weights.iter().map(|(j, w)| w * v[*j]).sum()
    }

    /// Order, density and elementary weights of the stages for every tree.
    fn elementary_weights(most: usize) -> Vec<(usize, f64, [f64; STAGES])> {
        let trees = trees(most);
        let mut on_stages: Vec<[f64; STAGES]> = Vec::new();
        for tree in &trees {
            let phi =
                std::array::from_fn(|i| tree.children.iter().map(|&c| dot(A[i], &on_stages[c])).product());
            on_stages.push(phi);
        }
        trees.iter().zip(on_stages).map(|(t, phi)| (t.order, t.density, phi)).collect()
    }

    #[test]
    fn dop853_rows_sum_to_abscissae() {
        for (a, c) in A.iter().zip(C) {
            let sum: f64 = a.iter().map(|(_, w)| w).sum();
            assert!((sum - c).abs() < 1e-14, "{sum} {c}");
        }
    }

    #[test]
    fn dop853_has_order_eight_with_embedded_orders_five_and_three() {
        let all = elementary_weights(9);
        // Numbers of rooted trees: A. Cayley's 1, 1, 2, 4, 9, 20, 48, 115, 286.
        assert_eq!(all.iter().filter(|t| t.0 <= 8).count(), 200);
        let defect = |order: usize, weights: &dyn Fn(&[f64; STAGES]) -> f64| {
            let of = all.iter().filter(|t| t.0 == order);
            of.map(|(_, density, phi)| (weights(phi) - 1.0 / density).abs()).fold(0.0, f64::max)
        };
        let solution = |phi: &[f64; STAGES]| dot(A[12], phi);
        for order in 1..=8 {
            assert!(defect(order, &solution) < 1e-13, "order {order}: {:e}", defect(order, &solution));
        }
        assert!(defect(9, &solution) > 1e-7);
        for (error, last) in [(ERROR_5, 5), (ERROR_3, 3)] {
            let embedded = |phi: &[f64; STAGES]| dot(A[12], phi) - dot(error, phi);
            for order in 1..=last {
                assert!(defect(order, &embedded) < 1e-13, "embedded {last}, order {order}");
            }
            assert!(defect(last + 1, &embedded) > 1e-6, "embedded {last}");
        }
    }

    #[test]
    fn dop853_continuous_extension_has_order_seven() {
        for theta in [0.0, 0.1, 0.35, 0.5, 0.77, 1.0] {
            let weights = dense_weights(theta);
            for (order, density, phi) in elementary_weights(7) {
                let sum: f64 = weights.iter().zip(phi).map(|(w, p)| w * p).sum();
                let expected = f64::powi(theta, order as i32) / density;
                assert!((sum - expected).abs() < 1e-12, "order {order} at {theta}: {sum} {expected}");
            }
        }
    }
}
